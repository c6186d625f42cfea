#!/usr/bin/env python3
"""Times the recipes and the page's examples that ask onsets and labels, on large tables: rows of input per
second of processor time (all threads), which other work on the machine blurs less than wall time; runs in turn.

usage: large_tables.py RESULTS [RUNS]
RESULTS: a folder made by `cargo bench --bench large_tables -- make`. Needs duckdb and polars (queries/requirements.txt).
"""
import importlib.util, os, re, statistics, sys, time

import duckdb
import polars as pl

results = sys.argv[1]
runs = int(sys.argv[2]) if len(sys.argv) > 2 else 5
queries = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "queries")
onsets, labels = f"{results}/onsets/*.parquet", f"{results}/labels/*.parquet"
rows = {path: pl.scan_parquet(path).select(pl.len()).collect().item() for path in (onsets, labels)}
patches = pl.scan_parquet(onsets).select(pl.col("lit").max()).collect().item()
key = (patches // 2, patches // 2 + 7)


def sql(name, **variables):
    text = open(f"{queries}/{name}.sql").read()
    for variable, value in {"results": results, **variables}.items():
        text = re.sub(rf"SET VARIABLE {variable} = .*;", f"SET VARIABLE {variable} = '{value}';", text)
    text = re.sub(r"--.*", "", text)
    *setup, question = [part for part in text.split(";") if part.strip()]
    return lambda: ([duckdb.execute(part) for part in setup], asked(question)())[1]


def recipe(name, *values):
    spec = importlib.util.spec_from_file_location(name, f"{queries}/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return lambda: module.answer(results, *values).height


def asked(text):
    return lambda: duckdb.sql(text).to_arrow_table().num_rows


bright = pl.col("snr") > 20
here = (pl.col("campaign") == "monday") & (pl.col("lit") == key[0]) & (pl.col("seen") == key[1])
of_capture = ["lit", "seen", "rank", "time_ps", "time_sd_ps"]
jobs = [
    ("onsets by bounces (queries/onsets)", rows[onsets] + rows[labels], sql("onsets"), recipe("onsets")),
    ("two days (queries/days)", rows[onsets], sql("days", one="monday", other="tuesday"), recipe("days", "monday", "tuesday")),
    (
        "onsets with snr > 20",
        rows[onsets],
        asked(f"SELECT count(*), avg(time_ps) FROM (SELECT lit, seen, time_ps, time_sd_ps FROM '{onsets}' WHERE snr > 20)"),
        lambda: pl.scan_parquet(onsets).filter(bright).select(pl.len(), pl.col("time_ps").mean()).collect().height,
    ),
    (
        "labels by bounces",
        rows[labels],
        asked(f"SELECT bounces, count(*) FROM '{labels}' GROUP BY bounces ORDER BY bounces"),
        lambda: pl.scan_parquet(labels).group_by("bounces").len().sort("bounces").collect().height,
    ),
    (
        f"one capture of {len(of_capture)} columns ({key[0]}, {key[1]})",
        rows[onsets],
        asked(f"SELECT {', '.join(of_capture)} FROM '{onsets}' WHERE campaign = 'monday' AND lit = {key[0]} AND seen = {key[1]}"),
        lambda: pl.scan_parquet(onsets).filter(here).select(of_capture).collect().height,
    ),
]
print(f"duckdb {duckdb.__version__}, polars {pl.__version__}, {runs} runs in turn\n")
print("| question | rows asked | rows of answer | DuckDB CPU s (min, median, max) | M rows a CPU s | Polars CPU s (min, median, max) | M rows a CPU s |\n|---|---|---|---|---|---|---|")
for name, size, *engines in jobs:
    seconds, answers = [[], []], [None, None]
    for turn in range(runs + 1):  # turn 0 warms up
        for k, engine in enumerate(engines):
            start = time.process_time()
            answers[k] = engine()
            if turn:
                seconds[k].append(time.process_time() - start)
    assert answers[0] == answers[1], (name, answers)
    cells = [f"{min(s):.3f}, {statistics.median(s):.3f}, {max(s):.3f} | {size / statistics.median(s) / 1e6:.1f}" for s in seconds]
    print(f"| {name} | {size} | {answers[0]} | {cells[0]} | {cells[1]} |", flush=True)

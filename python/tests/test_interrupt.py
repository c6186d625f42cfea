"""Ctrl-C ends long calls within two seconds, and the interpreter stays usable."""

from __future__ import annotations

import multiprocessing
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import gauss, gaussian_response

import periscope

LONG = """
import sys, time
import numpy as np
import periscope

time_ps = np.arange(60_000) * 10.0
rng = np.random.default_rng(1)
mean = rng.normal(0, 1e-4, 60_000)
for at in rng.uniform(1000, 599_000, 400):
    mean += np.exp(-0.5 * ((time_ps - at) / 60) ** 2)
step_ps = np.arange(-400.0, 401.0, 5.0)
response = periscope.Response(-400.0, 5.0, np.exp(-0.5 * (step_ps / 60) ** 2))
print("ready", flush=True)
try:
    periscope.deconvolve(mean, 1e-4, response, dt_ps=10.0, pulses_max=1000)
    print("finished", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
print(len(periscope.estimate_noise(mean).acf), flush=True)
"""


SEARCH = """
import itertools
import numpy as np
import periscope

rng = np.random.default_rng(2)
wall_m = np.column_stack([rng.uniform(-1, 1, (60, 2)), np.zeros(60)])
pairs = list(itertools.combinations(range(60), 2))
times_ps = [rng.uniform(0, 30_000, 40) for _ in pairs]
print("ready", flush=True)
try:
    periscope.find_hidden(wall_m, pairs, times_ps, 5.0, (0.0, 30_000.0), source_m=(0.0, 0.0, 1.0))
    print("finished", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
print(len(periscope.estimate_noise(times_ps[0]).acf), flush=True)
"""


def interrupted(code: str, after_s: float) -> tuple[list[str], float]:
    """What a program prints that gets Ctrl-C some time after its first line, and how long it takes to end.

    One that does not end is killed.
    """
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    time.sleep(after_s)
    sent = time.monotonic()
    process.send_signal(signal.SIGINT)
    try:
        printed, _ = process.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        process.kill()
        printed, _ = process.communicate()
    return printed.splitlines(), time.monotonic() - sent


@pytest.mark.parametrize("code", [LONG, SEARCH], ids=["deconvolve", "find_hidden"])
def test_ctrl_c_ends_a_kernel(code: str) -> None:
    printed, elapsed_s = interrupted(code, 0.5)
    assert printed == ["interrupted", "32"] and elapsed_s < 3.0


def test_ctrl_c_ends_a_run_and_keeps_what_is_finished(campaign: Path, tmp_path: Path) -> None:
    code = f"""
import periscope
print("ready", flush=True)
try:
    while True:
        periscope.run({str(campaign)!r}, "all-visible", {str(tmp_path / "out")!r}, progress="none")
        import shutil; shutil.rmtree({str(tmp_path / "out")!r})
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
    printed, elapsed_s = interrupted(code, 0.3)
    assert printed == ["interrupted"] and elapsed_s < 3.0
    results = periscope.run(campaign, "all-visible", tmp_path / "out", progress="none")
    assert len(results.patches) > 0


def arrival_ps(sd_ps: float) -> float:
    time_ps = np.arange(200) * 50.0
    pulses = periscope.deconvolve(gauss(time_ps - 4000.0, sd_ps), 1e-3, gaussian_response(sd_ps), dt_ps=50.0)
    return float(pulses.time_ps[0])


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_kernels_compute_in_a_forked_process_too() -> None:
    assert arrival_ps(50.0) == pytest.approx(4000.0, abs=1.0)  # starts the threads of this process
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(arrival_ps, [50.0, 60.0, 70.0]).get(timeout=30) == pytest.approx([4000.0] * 3, abs=1.0)


def test_other_threads_run_while_a_kernel_computes() -> None:
    time_ps = np.arange(20_000) * 10.0
    mean = sum(gauss(time_ps - at, 60.0) for at in np.linspace(2_000.0, 190_000.0, 60))
    ticks, is_over = [0], threading.Event()

    def tick() -> None:
        while not is_over.is_set():
            ticks[0] += 1
            time.sleep(1e-3)

    ticker = threading.Thread(target=tick)
    ticker.start()
    start = time.monotonic()
    periscope.deconvolve(mean, 1e-3, gaussian_response(60.0), dt_ps=10.0)
    elapsed = time.monotonic() - start
    is_over.set()
    ticker.join()
    if elapsed < 0.05:
        pytest.skip(f"the kernel took {elapsed:.3f} s, too short to see another thread run")
    assert ticks[0] > 50 * elapsed

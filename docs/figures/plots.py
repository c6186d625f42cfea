#!/usr/bin/env python3
"""Draws the plots of the study pages from the tables of these pages, so that plot and table cannot differ.

    python3 docs/figures/plots.py            # writes docs/figures/*.svg
    python3 docs/figures/plots.py --check    # exit code 1 if a committed plot differs from its table

Needs nothing beyond Python 3.9. The same tables give the same bytes.
"""

import math
import re
import sys
from html import escape
from pathlib import Path

FIGURES = Path(__file__).resolve().parent
DOCS = FIGURES.parent
COLOURS = ["#3b7fc4", "#d9822b", "#3a9d5d", "#9a62c7", "#c94f4f", "#7d8790"]
STYLE = """<style>
.back{fill:#fff}.ink{fill:#24292f}.soft{fill:#57606a}.axis{stroke:#8c959f}.grid{stroke:#d8dee4}.ref{stroke:#57606a;stroke-dasharray:5 4}
text{font:12px system-ui,sans-serif}.title{font-size:14px;font-weight:600}
@media(prefers-color-scheme:dark){.back{fill:#0d1117}.ink{fill:#e6edf3}.soft{fill:#9da7b1}.axis{stroke:#6e7681}.grid{stroke:#2b323b}.ref{stroke:#9da7b1}}
</style>"""


# Tables ------------------------------------------------------------------------------------------------------------


def tables(page, first):
    """All tables of a page whose header line starts with `first`: lists of rows, each a list of cells."""
    found, lines = [], (DOCS / page).read_text(encoding="utf-8").splitlines()
    for index, line in enumerate(lines):
        if line.startswith(first) and index + 1 < len(lines) and set(lines[index + 1]) <= set("|-: "):
            rows = []
            for row in lines[index + 2 :]:
                if not row.startswith("|"):
                    break
                rows.append([cell.strip().replace("`", "") for cell in row.strip().strip("|").split("|")])
            found.append(rows)
    if not found:
        sys.exit(f"{page}: no table starts with `{first}`")
    return found


def table(page, first):
    """The first of `tables`."""
    return tables(page, first)[0]


def numbers(cell):
    """All numbers of a cell, in order; `4,096` is one number, `0.1, 0.2` are two."""
    return [float(text.replace(",", "")) for text in re.findall(r"-?\d+(?:,\d{3})*(?:\.\d+)?(?:e-?\d+)?", cell)]


def value(cell):
    """A cell's value with its interval: `1.0 [0.9, 1.1]`, `1.0 ± 0.1` or a number alone."""
    read = numbers(cell)
    if not read:
        return None
    if "[" in cell and len(read) >= 3:
        return read[0], read[-2], read[-1]
    if "±" in cell:
        return read[0], read[0] - read[1], read[0] + read[1]
    return read[0], None, None


def spread(cell):
    """A cell `least, median, largest`, or one number alone."""
    read = numbers(cell)
    return (read[-2], read[-3], read[-1]) if len(read) >= 3 else (read[0], None, None)


# Drawing -----------------------------------------------------------------------------------------------------------


def ticks(low, high, is_log):
    """Round values within an axis."""
    if is_log:
        exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for steps, every in (((1, 2, 5), 1), ((1,), 1), ((1,), 2)):
            marks = [step * 10.0**exponent for exponent in exponents if exponent % every == 0 for step in steps]
            marks = [mark for mark in marks if low * 0.999 <= mark <= high * 1.001]
            if len(marks) <= 7:
                break
        return marks
    step = 10.0 ** math.floor(math.log10((high - low) / 3))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (step * factor) <= 8)
    first = math.ceil(low / step - 1e-9)
    return [step * index for index in range(first, math.floor(high / step + 1e-9) + 1)]


def text_of(number):
    """A tick's number."""
    if number and (abs(number) >= 1e6 or abs(number) < 1e-3):
        return f"{number:.0e}".replace("e+0", "e").replace("e-0", "e-")
    return f"{number:,.10g}" if abs(number) >= 1 else f"{number:.4g}"


class Axis:
    """Values to pixels."""

    def __init__(self, low, high, start, end, is_log):
        self.low, self.high, self.start, self.end, self.is_log = low, high, start, end, is_log

    def __call__(self, number):
        change = math.log10 if self.is_log else float
        number = min(max(number, self.low), self.high)
        share = (change(number) - change(self.low)) / (change(self.high) - change(self.low))
        return round(self.start + share * (self.end - self.start), 1)


def limits(values, is_log, given):
    """An axis that holds all values."""
    low, high = min(values), max(values)
    if is_log:
        low, high = low / 1.3, high * 1.3
    else:
        margin = (high - low or 1) * 0.06
        low, high = low - margin, high + margin
    given = given or (None, None)
    return given[0] if given[0] is not None else low, given[1] if given[1] is not None else high


def text(x, y, words, kind="ink", anchor="start", extra=""):
    return f'<text x="{x}" y="{y}" class="{kind}" text-anchor="{anchor}"{extra}>{escape(words)}</text>'


def line(x1, y1, x2, y2, kind="axis", extra=""):
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" class="{kind}"{extra}/>'


def legend(names, width, top):
    """Coloured names in rows, and the height that they take."""
    parts, x, y = [], 16, top
    for index, name in enumerate(names):
        wide = 30 + 6.6 * len(name)
        if x + wide > width - 10 and x > 16:
            x, y = 16, y + 18
        parts.append(f'<circle cx="{x + 5}" cy="{y - 4}" r="5" fill="{COLOURS[index]}"/>')
        parts.append(text(x + 16, y, name))
        x = round(x + wide, 1)
    return parts, y - top + 24 if names else 0


def page_of(title, width, height, parts):
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img">'
    back = f'<rect width="{width}" height="{height}" class="back"/>'
    return "\n".join([head, f"<title>{escape(title)}</title>", STYLE, back, *parts, "</svg>", ""])


def dots(title, label, rows, groups=(), reference=None, is_log=False, given=None):
    """A line for each row: its name, and a dot with its interval for each (group, value)."""
    width, left = 760, 20 + min(330, round(6.5 * max(len(name) for name, _ in rows)))
    parts = [text(16, 26, title, "title")]
    keys, tall = legend(groups, width, 50)
    parts += keys
    top, step = 38 + tall, 22
    bottom = top + step * len(rows)
    all_values = [number for _, points in rows for _, point in points for number in point if number is not None]
    low, high = limits(all_values + ([reference[0]] if reference else []), is_log, given)
    axis = Axis(low, high, left, width - 24, is_log)
    for tick in ticks(low, high, is_log):
        parts.append(line(axis(tick), top, axis(tick), bottom, "grid"))
        parts.append(text(axis(tick), bottom + 16, text_of(tick), "soft", "middle"))
    if reference:
        parts.append(line(axis(reference[0]), top, axis(reference[0]), bottom, "ref"))
        parts.append(text(left, bottom + 52, "dashed: " + reference[1], "soft"))
    for index, (name, points) in enumerate(rows):
        y = top + step * index + step / 2
        name = name if len(name) <= 52 else name[:51] + "…"
        parts.append(text(left - 8, y + 4, name, "ink", "end"))
        for group, (mid, least, most) in points:
            at = round(y + 4.5 * (group - (len(groups) - 1) / 2), 1) if len(groups) > 1 else y
            colour = COLOURS[group]
            if least is not None:
                parts.append(line(axis(least), at, axis(most), at, "bar", f' stroke="{colour}" stroke-width="2"'))
            parts.append(f'<circle cx="{axis(mid)}" cy="{at}" r="3.6" fill="{colour}"/>')
    parts.append(line(left, bottom, width - 24, bottom))
    parts.append(text(left, bottom + 36, label, "soft"))
    return page_of(title, width, bottom + (64 if reference else 48), parts)


def ranks(title, rows):
    """A histogram for each row: its name, and counts in parts of equal probability, with what chance makes of equal ones."""
    columns, wide, tall, width = 2, 340, 78, 760
    parts = [text(16, 26, title, "title")]
    for index, (name, counts) in enumerate(rows):
        left, top = 24 + index % columns * (wide + 36), 44 + index // columns * (tall + 44)
        expected, bar = sum(counts) / len(counts), wide / len(counts)
        scale = tall / max(*counts, 2 * expected)
        parts.append(text(left, top + 6, name))
        bottom = top + tall + 16
        for place, count in enumerate(counts):
            x, high = round(left + place * bar, 1), round(scale * count, 1)
            parts.append(f'<rect x="{x}" y="{round(bottom - high, 1)}" width="{round(bar - 2, 1)}" height="{high}" fill="{COLOURS[0]}"/>')
        for sigmas in (-2, 2):
            y = round(bottom - scale * (expected + sigmas * math.sqrt(expected * (1 - 1 / len(counts)))), 1)
            parts.append(line(left, y, left + wide, y, "ref"))
        parts.append(line(left, bottom, left + wide, bottom))
    height = 44 + math.ceil(len(rows) / columns) * (tall + 44) + 24
    parts.append(text(24, height - 12, "dashed: two standard deviations about equal counts", "soft"))
    return page_of(title, width, height, parts)


def lines(title, across, up, series, logs=(False, False), reference=None, given_x=None, given_y=None):
    """A line for each series of (x, (y, least, most))."""
    width, left, right = 760, 70, 736
    parts = [text(16, 26, title, "title")]
    keys, tall = legend([name for name, _ in series] if len(series) > 1 else [], width, 50)
    parts += keys
    top = 64 + tall
    bottom = top + 270
    low, high = limits([x for _, points in series for x, _ in points], logs[0], given_x)
    horizontal = Axis(low, high, left, right, logs[0])
    heights = [number for _, points in series for _, point in points for number in point if number is not None]
    least, most = limits(heights + ([reference[0]] if reference else []), logs[1], given_y)
    vertical = Axis(least, most, bottom, top, logs[1])
    for tick in ticks(low, high, logs[0]):
        parts.append(line(horizontal(tick), top, horizontal(tick), bottom, "grid"))
        parts.append(text(horizontal(tick), bottom + 16, text_of(tick), "soft", "middle"))
    for tick in ticks(least, most, logs[1]):
        parts.append(line(left, vertical(tick), right, vertical(tick), "grid"))
        parts.append(text(left - 6, vertical(tick) + 4, text_of(tick), "soft", "end"))
    if reference:
        parts.append(line(left, vertical(reference[0]), right, vertical(reference[0]), "ref"))
        parts.append(text(left, bottom + 54, "dashed: " + reference[1], "soft"))
    for index, (_, points) in enumerate(series):
        colour = COLOURS[index]
        path = " ".join(f"{horizontal(x)},{vertical(y[0])}" for x, y in points)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        for x, (mid, under, over) in points:
            if under is not None:
                ends = vertical(under), vertical(over)
                parts.append(line(horizontal(x), ends[0], horizontal(x), ends[1], "bar", f' stroke="{colour}" stroke-width="1.5"'))
            parts.append(f'<circle cx="{horizontal(x)}" cy="{vertical(mid)}" r="3.6" fill="{colour}"/>')
    parts.append(line(left, bottom, right, bottom))
    parts.append(line(left, top, left, bottom))
    parts.append(text(left, bottom + 38, across, "soft"))
    parts.append(text(left - 54, top - 10, up, "soft"))
    return page_of(title, width, bottom + (66 if reference else 50), parts)


# Plots -------------------------------------------------------------------------------------------------------------


def one(rows, name, column):
    """Rows of a plot with one group: named by `name` (a column, or a function of the row)."""
    label = name if callable(name) else lambda row: row[name]
    return [(label(row), [(0, value(row[column]))]) for row in rows if value(row[column])]


def grouped(rows, name, columns, read=value):
    """Rows of a plot with a group for each column."""
    label = name if callable(name) else lambda row: row[name]
    read_rows = [(label(row), [(group, read(row[column])) for group, column in enumerate(columns) if read(row[column])]) for row in rows]
    return [row for row in read_rows if row[1]]


def by(rows, key, x, y, read=value):
    """Series of lines: rows put together by `key`."""
    series = {}
    for row in rows:
        if read(row[y]):
            series.setdefault(key(row), []).append((numbers(row[x])[0], read(row[y])))
    return list(series.items())


def accuracy():
    yield "accuracy-bound", dots(
        "Positions from scope files: bound over error",
        "Cramer-Rao bound / rms error, 95 % intervals",
        one(table("accuracy.md", "| scene | seeds | rms"), 0, 4),
        reference=(1, "the bound"),
    )
    rows = [row for row in table("accuracy.md", "| hidden | noise (ps) |") if row[2] == "30 % / 4"]
    yield "accuracy-corner", lines(
        "Hidden patches with 30 % of the arrivals missing and 4 false ones a profile",
        "hidden patches",
        "share of scenes with every hidden patch right and none made up",
        by(rows, lambda row: f"onset noise {row[1]} ps", 0, 4),
        logs=(True, False),
        given_x=(0.9, 9),
        given_y=(0, 1.03),
    )
    yield "accuracy-faint", lines(
        "A hidden patch too weak for an onset",
        "signal-to-noise ratio of its third bounces in one profile (rms over profiles)",
        "share of scenes in which the stage search finds it",
        by(table("accuracy.md", "| SNR, rms over profiles"), lambda row: "found, with 95 % interval", 0, 3),
        given_y=(0, 1.03),
    )
    yield "accuracy-dots", dots(
        "Small things behind a relay wall",
        "rms error / Cramer-Rao bound",
        one(table("accuracy.md", "| scene | photons | campaigns"), lambda row: f"{row[0]}, {row[1]} photons", 6),
        reference=(1, "the bound"),
    )
    yield "accuracy-rooms", dots(
        "Small rooms: share of rooms that are confidently wrong",
        "share of 56 rooms, 95 % intervals",
        [
            (f"{row[0]} of pairs missing, {row[1]} spurious", [(0, value(row[3].split(":")[1]))])
            for row in table("accuracy.md", "| pairs missing | profiles")
        ],
        reference=(0.01, "the goal, 1 %"),
    )


def time_resolution():
    pairs = tables("time-resolution.md", "| apart (ps) |")
    snrs = ["10", "31.6", "100", "316", "1000"]
    for name, rows, response in zip("ge", pairs, ("a Gaussian response of 250 ps", "a fast diode of 151 ps")):
        series = [
            (f"SNR {snr}", [(numbers(row[0])[0], value(row[1 + column].split(";")[0])) for row in rows])
            for column, snr in enumerate(snrs)
        ]
        yield f"time-resolution-pairs-{name}", lines(
            f"Two equal pulses behind {response}",
            "distance of the pulses (ps)",
            "share of records in which exactly two are found",
            series,
            logs=(True, False),
            given_y=(0, 1.03),
        )
    rows = table("time-resolution.md", "| response | light | draws | right number")
    yield "time-resolution-coverage", dots(
        "How often 95 % intervals of times hold",
        "share of true times within the interval",
        one(rows, lambda row: f"{row[0]}: {row[1].split(';')[0]}", 6),
        reference=(0.95, "0.95"),
    )
    rows = table("time-resolution.md", "| patches (cm) | SNR | hidden | instrument")
    yield "time-resolution-readings", dots(
        "Rooms through files: how often 95 % intervals of coordinates hold",
        "share of coordinates within the interval",
        one(rows, lambda row: f"{row[0]} cm, SNR {row[1]}, hidden: {row[2]}, {row[3]}", 9),
        reference=(0.95, "0.95"),
    )


def error_bars():
    rows, names = table("error-bars.md", "| instrument | SNR | records"), []
    for row in rows:
        if row[0] not in names:
            names.append(row[0])
    snrs = ["10", "50", "200"]
    yield "error-bars", dots(
        "Onsets of imperfect instruments: how often 95 % intervals hold",
        "share of true onsets within the interval",
        [(name, [(snrs.index(row[1]), value(row[6])) for row in rows if row[0] == name]) for name in names],
        groups=[f"SNR {snr}" for snr in snrs],
        reference=(0.95, "0.95"),
    )
    rows = [row for row in table("error-bars.md", "| instrument | rooms | ranks |") if row[0].endswith(", visible")]
    yield "error-bars-ranks", ranks(
        "Ranks of true positions in what is stated of them, in tenths",
        [(row[0].removesuffix(", visible"), [numbers(cell)[0] for cell in row[3:]]) for row in rows],
    )


def reliability():
    rows = table("reliability.md", "| files | flips | found by")
    found = [(row[0], [(0, value(row[2].split("=")[1]))]) for row in rows]
    raw = table("reliability.md", "| raw files | flips")[0]
    settings = table("reliability.md", "| settings | flips")
    found += [("raw files, with --rehash", [(0, value(raw[2].split("=")[1]))])]
    found += [(row[0] + ", sealed", [(0, value(row[2].split("=")[1]))]) for row in settings]
    yield "reliability-flips", dots(
        "One flipped bit at a time: share that periscope verify finds", "share found, 95 % intervals", found, given=(0.82, 1.005)
    )
    rows = table("reliability.md", "| files so far | resident")[:-2]
    yield "reliability-watch", lines(
        "periscope run --watch while a campaign grows",
        "files in the campaign",
        "resident memory (MiB)",
        by(rows, lambda row: "resident memory", 0, 1),
        given_y=(0, None),
    )


def growth():
    rows = table("growth.md", "| patches | 12 others anywhere")
    columns = [("12 others anywhere", 2), ("the 12 nearest", 3), ("all pairs", 5)]
    series = [
        (name, [(numbers(row[0])[0], spread(row[column])) for row in rows if numbers(row[column])])
        for name, column in columns
    ]
    yield "growth-refine", lines(
        "Refinement: processor time of one thread", "patches", "seconds (least, median, largest)", series, logs=(True, True)
    )
    rows = table("growth.md", "| hidden patches | onsets | known beforehand")
    columns = [("paths over known patches", 2), ("search alone", 4), ("the stage with its search", 6)]
    series = [(name, [(numbers(row[0])[0], spread(row[column])) for row in rows]) for name, column in columns]
    yield "growth-labels", lines(
        "Labels: processor time of one thread", "hidden patches", "seconds (least, median, largest)", series, logs=(True, True)
    )
    rows = table("growth.md", "| points | light-cone transform")
    columns = [("light-cone transform", 1), ("f-k migration", 2), ("locate", 3)]
    series = [
        (name, [(numbers(row[0])[0], (numbers(row[column])[0], None, None)) for row in rows if numbers(row[column])])
        for name, column in columns
    ]
    yield "growth-scans", lines(
        "Scans of a relay wall: processor time", "points along each side of the wall", "seconds", series, logs=(True, True)
    )


def reproduction():
    names, rows = {"G": "Gaussian", "E": "fast edge"}, []
    response = ""
    for row in table("reproduction.md", "| response | method | position (cm)"):
        response = row[0] or response
        where = f"{names[response]}: {row[1]}" if response else row[1]
        rows.append((where, [(0, (numbers(row[2])[0], None, None))]))
    yield "reproduction-mirror", dots(
        "Missing direct reflection: error of the worst of three mirror points", "median position error (cm)", rows, is_log=True
    )
    rows = table("reproduction.md", "| room | response | scans | diffuser")
    yield "reproduction-barcode", dots(
        "Barcode: largest error of a coordinate of both strips",
        "median error (cm)",
        grouped(rows, lambda row: f"{row[0]}, {row[1]}, diffuser to {row[3]} mm", [7, 9], lambda cell: (numbers(cell)[0], None, None)),
        groups=["Periscope", "the paper's protocol on the same room"],
        is_log=True,
    )


def geometry():
    rows = table("geometry.md", "| noise (ps) | delay | bound (mm) | method")
    methods = []
    for row in rows:
        if row[3] not in methods:
            methods.append(row[3])
    cells = list(dict.fromkeys((row[0], row[1]) for row in rows))
    yield "geometry-methods", dots(
        "Methods, all pairs measured: error over the bound",
        "rms error / Cramer-Rao bound, 95 % intervals",
        [(method, [(cells.index((row[0], row[1])), value(row[4])) for row in rows if row[3] == method]) for method in methods],
        groups=[f"{noise} ps, delay {delay}" for noise, delay in cells],
        reference=(1, "the bound"),
    )
    rows = table("geometry.md", "| missing | scenes | open")
    yield "geometry-missing", lines(
        "Missing pairs: share of scenes that are solved",
        "pairs missing (%)",
        "share of scenes within 2 bounds",
        [
            ("start of Periscope, several descents", [(numbers(row[0])[0], (numbers(row[3])[0], *numbers(row[4])[:2])) for row in rows]),
            ("one descent only", [(numbers(row[0])[0], (numbers(row[7])[0], None, None)) for row in rows]),
        ],
        given_y=(0, 1.03),
    )
    rows = table("geometry.md", "| set-up | free")
    yield "geometry-stations", dots(
        "Separate stations, onset noise 25 ps: the bound of a position",
        "Cramer-Rao bound (mm)",
        [
            (name, [(int(row[2] != "0 %"), (numbers(row[7])[0], None, None)) for row in rows if row[0] == name and row[3] == "25"])
            for name in dict.fromkeys(row[0] for row in rows)
        ],
        groups=["all pairs", "half of the pairs missing"],
        is_log=True,
    )
    rows = table("geometry.md", "| patches | pairs | delay | passes")
    yield "geometry-many", lines(
        "Many patches: processor time of the solver for all pairs",
        "patches",
        "seconds",
        [(f"delay {key}", points) for key, points in by(rows, lambda row: row[2], 0, 5)],
        logs=(True, True),
    )


def performance():
    runs = tables("performance.md", "| job | wall s (min, median, max) | MB/s (median) | CPU s | peak MiB | rate over numpy (paired")
    for name, rows, size in (("small", runs[0], "82 MB, 200 captures"), ("large", runs[2], "819 MB, 2,000 captures")):
        yield f"performance-{name}", dots(
            f"Averaging {size}: rate over a tuned NumPy program",
            "rate over NumPy (least, median and largest of runs in turn)",
            [(row[0], [(0, spread(row[5]))]) for row in rows],
            reference=(1, "NumPy"),
            is_log=True,
        )


def surfaces():
    rows = [row for row in table("surfaces.md", "| scene | photons | kind | scans") if row[2] == "smooth"]
    scenes = list(dict.fromkeys(row[0] for row in rows))
    photons = list(dict.fromkeys(row[1] for row in rows))

    def hold(cell):
        read = numbers(cell)
        return tuple(read[:3]) if len(read) >= 3 else None

    yield "surfaces-coverage", dots(
        "Smooth points of simulated surfaces: how often 95 % intervals hold",
        "share of points within the interval (bars: least to most of a scan)",
        [(s, [(photons.index(row[1]), hold(row[6])) for row in rows if row[0] == s and hold(row[6])]) for s in scenes],
        groups=[f"{count} photons" for count in photons],
        reference=(0.95, "0.95"),
    )
    rows = table("surfaces.md", "| scene | method | points | median distance")
    yield "surfaces-methods", dots(
        "Median distance from the true surface, 3,000 photons",
        "median distance (mm)",
        [(f"{row[0]}: {row[1]}", [(0, value(row[3]))]) for row in rows if value(row[3])],
        is_log=True,
    )


def interoperation():
    rows = table("interoperation.md", "| capture | first point | second point")
    yield "interoperation", dots(
        "Hidden points from captures of other programs",
        "error (mm); the bar ends at the standard deviation that is stated",
        [
            (row[0], [(group, (numbers(cell)[0], *sorted(numbers(cell)[:2]))) for group, cell in enumerate(row[1:3])])
            for row in rows
        ],
        groups=["first point", "second point"],
        given=(0, None),
    )


def one_pipeline():
    rows = table("one-pipeline.md", "| scene | all-visible, seed 1")
    yield "one-pipeline", dots(
        "Visible patches: scene next to all-visible, seed 1",
        "rms error (mm)",
        grouped(rows, 0, [1, 2]),
        groups=["all-visible", "scene"],
        is_log=True,
    )


def real_light():
    rows = table("real-light.md", "| photons | method | width across")
    yield "real-light-width", lines(
        "Width of a diffuse point in depth",
        "photons in a mean histogram",
        "full width at half maximum (mm)",
        by(rows, lambda row: row[1], 0, 3),
        logs=(True, False),
        given_y=(0, None),
    )


HOURS = {"s": 1 / 3600, "min": 1 / 60, "h": 1.0, "days": 24.0, "years": 24 * 365.25}


def what_can_be_seen():
    def hours(cell):
        """The first time of a cell and the last, in hours."""
        read = re.findall(r"([\d.]+)(?: to ([\d.]+))? (s|min|h|days|years)", cell)
        times = [float(number) * HOURS[unit] for *pair, unit in read for number in pair if number]
        return (times[0], min(times), max(times)) if times else None

    rows, experiment = [], ""
    for row in table("what-can-be-seen.md", "| experiment | what | one shot"):
        experiment = row[0] or experiment
        if hours(row[4]):
            short = experiment.split(",")[0].replace("diffuse hidden patch of 5 cm", "Hidden patch of 5 cm").replace(" bottom", "")
            what = row[1].replace("third bounce by way of either mirror", "third bounce by either mirror")
            what = what.replace("second bounce between visible ones, median", "second bounce").replace(", strongest to weakest", "")
            points = [(group, hours(row[column])) for group, column in enumerate((4, 5)) if hours(row[column])]
            rows.append((f"{short}: {what}", points))
    yield "what-can-be-seen", dots(
        "Time until one profile shows the bounce (SNR 5, response G)",
        "hours",
        rows,
        groups=["at the laser's full rate", "at 100,000 shots a second"],
        is_log=True,
    )


def counts():
    yield "counts", dots(
        "Instructions of each kernel",
        "instructions",
        one(table("counts.md", "| kernel | instructions |"), 0, 1),
        is_log=True,
    )


def scale():
    rows = table("scale.md", "| campaign | captures | raw files | one machine")
    units = {"s": 1.0, "min": 60.0, "h": 3600.0, "days": 86400.0}

    def seconds(cell):
        read = re.match(r"([\d.]+) (s|min|h|days)", cell)
        return (float(read[1]) * units[read[2]], None, None) if read else None

    yield "scale", dots(
        "One machine with 16 cores: computed time of a plain job",
        "seconds, by the rates above the table",
        [(f"{row[0].split(', ')[0]}, {row[2]}", [(g, seconds(row[3 + g])) for g in (0, 1) if seconds(row[3 + g])]) for row in rows],
        groups=["disk of 1 GB/s", "disk of 150 MB/s"],
        is_log=True,
    )


def instrument_checks():
    good = table("instrument-checks.md", "| good instrument | seeds | passed")
    bad = table("instrument-checks.md", "| fault | seeds | found")
    share = lambda row: (numbers(row[2])[0], *numbers(row[3])[:2])
    yield "instrument-checks", dots(
        "Instrument checks",
        "% of seeds, 95 % intervals",
        [("passes: " + row[0], [(0, share(row))]) for row in good] + [("found: " + row[0], [(1, share(row))]) for row in bad],
        groups=["good instrument passes", "fault is found, and its cause named"],
    )


STUDIES = [
    accuracy, time_resolution, error_bars, reliability, growth, reproduction, geometry, performance, surfaces,
    interoperation, one_pipeline, real_light, what_can_be_seen, counts, scale, instrument_checks,
]  # fmt: skip


def main():
    differ = []
    for study in STUDIES:
        for name, svg in study():
            path = FIGURES / f"{name}.svg"
            if len(svg) > 150_000:
                sys.exit(f"{path.name} has more than 150 kB")
            if "--check" in sys.argv:
                if not path.exists() or path.read_text(encoding="utf-8") != svg:
                    differ.append(path.name)
            else:
                path.write_text(svg, encoding="utf-8", newline="\n")
    if differ:
        sys.exit("differ from their tables: " + ", ".join(differ) + "; run docs/figures/plots.py")


if __name__ == "__main__":
    main()

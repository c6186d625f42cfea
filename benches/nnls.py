"""SciPy's non-negative least squares on the records of `cargo bench --bench resolution` (table g): seconds a record, by file, as JSON.

    python benches/nnls.py FOLDER

Needs numpy and SciPy. Arrivals lie on a grid of half a sample: around the light, as if someone had told where it is, and over the whole
record. Making the matrix is not timed.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

AROUND_PS = 300
ROUNDS = 3
WHOLE_RECORDS = 2  # they take seconds each


def matrix(dt, samples, arrivals, response):
    later = dt * samples[:, None] - arrivals[None, :]
    return np.interp(later, *response, left=0, right=0)


def timed(columns, data, rounds):
    best = np.inf
    for _ in range(rounds):
        start = time.perf_counter()
        nnls(columns, data)
        best = min(best, time.perf_counter() - start)
    return best


def seconds(path):
    told = json.loads(path.read_text())
    dt, sd, shape = told["dt_ps"], told["sd"], told["response"]
    values = np.array(shape["values"])
    response = (shape["t0_ps"] + shape["step_ps"] * np.arange(values.size), values)
    records = [np.array(record) / sd for record in told["records"]]
    light = 0.0
    for record, (first_ps, last_ps) in zip(records, told["light_ps"]):
        arrivals = np.arange(first_ps - AROUND_PS, last_ps + AROUND_PS, dt / 2)
        begin = max(0, int((arrivals[0] + response[0][0]) / dt))
        end = min(record.size, int((arrivals[-1] + response[0][-1]) / dt))
        light += timed(matrix(dt, np.arange(begin, end), arrivals, response) / sd, record[begin:end], ROUNDS)
    whole = records[:WHOLE_RECORDS]
    size = whole[0].size
    columns = matrix(dt, np.arange(size), dt / 2 * np.arange(2 * size), response) / sd
    return [light / len(records), sum(timed(columns, record, 1) for record in whole) / len(whole)]


print(json.dumps({path.stem: seconds(path) for path in sorted(Path(sys.argv[1]).glob("*.json"))}))

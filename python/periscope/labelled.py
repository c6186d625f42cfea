"""Profiles as labelled arrays of xarray, where it is installed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .optional import need

if TYPE_CHECKING:
    from ._periscope import Table

ON_GRID = 1e-3
"""Share of a sample by which times of one grid may differ."""


def dataset(table: Table, sensor: str | None) -> Any:
    """The profiles of the scene, lit by seen by time; NaN where there are none."""
    xarray = need("xarray", "to_xarray")
    rows = _rows(table, sensor)
    lit, i = np.unique(table["lit"][rows], return_inverse=True)
    seen, k = np.unique(table["seen"][rows], return_inverse=True)
    t0_ps: NDArray[np.float64] = table["t0_ps"][rows]
    dt_ps: NDArray[np.float64] = table["dt_ps"][rows]
    if np.ptp(dt_ps) > 0.0:
        raise ValueError("profiles have different times between samples; read the table through Arrow")
    means, errors, counts, levels = (table[name][rows] for name in ("mean_v", "se_v", "counts", "baseline_v"))
    # Those of a photon counter follow from its counts.
    means = [count - level if mean is None else mean for mean, count, level in zip(means, counts, levels)]
    errors = [
        np.sqrt(np.maximum(count, max(level, 1.0))) if error is None else error
        for error, count, level in zip(errors, counts, levels)
    ]
    first: NDArray[np.float64] = (t0_ps - t0_ps.min()) / dt_ps
    nearest = np.rint(first)
    is_one_grid = bool(np.abs(first - nearest).max() < ON_GRID)
    start = (nearest if is_one_grid else 0.0 * first).astype(np.int64)
    shape = (len(lit), len(seen), int(max(n + len(values) for n, values in zip(start, means))))

    def filled(values: Any) -> Any:
        whole = np.full(shape, np.nan)
        for a, b, n, row in zip(i, k, start, values):
            whole[a, b, n : n + len(row)] = row
        return whole

    def each(values: Any) -> Any:
        whole = np.full(shape[:2], np.nan)
        whole[i, k] = values
        return whole

    pair, all_axes = ("lit", "seen"), ("lit", "seen", "time")
    steps_ps = np.arange(shape[2]) * dt_ps[0]
    if is_one_grid:
        time = ("time", t0_ps.min() + steps_ps, {"units": "ps"})
    else:
        time = (all_axes, each(t0_ps)[:, :, None] + steps_ps, {"units": "ps"})
    variables: dict[str, Any] = {
        "mean_v": (all_axes, filled(means), {"units": "V", "long_name": "mean"}),
        "se_v": (all_axes, filled(errors), {"units": "V", "long_name": "standard error of the mean"}),
        "shots": (pair, each(table["shots"][rows]), {"long_name": "averaged shots"}),
        "noise_v": (pair, each(table["noise_v"][rows]), {"units": "V", "long_name": "noise of one shot"}),
    }
    if all(values is not None for values in counts):
        variables["counts"] = (all_axes, filled(counts), {"long_name": "photons"})
    return xarray.Dataset(variables, coords={"lit": lit, "seen": seen, "time_ps": time})


def _rows(table: Table, sensor: str | None) -> Any:
    """Numbers of the rows of the scene, of one sensor of one campaign at one range."""
    is_scene = table["role"] == "scene"
    sensors = sorted(set(table["sensor"][is_scene]))
    if sensor is None and len(sensors) > 1:
        raise ValueError(f"name one sensor: there are {sensors}")
    rows = np.flatnonzero(is_scene if sensor is None else is_scene & (table["sensor"] == sensor))
    if len(rows) == 0:
        raise ValueError(f"there are no profiles of sensor {sensor!r}; sensors are {sensors}")
    pairs = list(zip(table["lit"][rows], table["seen"][rows]))
    if len(set(pairs)) < len(pairs):
        raise ValueError("several campaigns or ranges have profiles of one pair; read the table through Arrow")
    return rows

"""Campaigns from arrays in memory."""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Union, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._periscope import load_campaign
from .errors import CampaignError

__all__ = ["write_campaign"]

StrPath = Union[str, "os.PathLike[str]"]
Pair = tuple[int, int]
Array = NDArray[Any]
ByPair = Union[ArrayLike, Mapping[Pair, ArrayLike]]

SENSOR = "s1"
STORED = ("int8", "uint8", "int16", "uint16", "int32", "float32", "float64")


@dataclass(frozen=True)
class Recording:
    """The records of one file: [shot, sample]."""

    file: str
    samples: Array
    t0_ps: Array
    """One time for all shots, or one for each."""
    reference: Array | None
    columns: dict[str, int]


def write_campaign(
    folder: StrPath,
    scene: ByPair,
    *,
    dt_ps: float,
    t0_ps: ByPair = 0.0,
    lit: Sequence[int] | None = None,
    seen: Sequence[int] | None = None,
    kind: Literal["analog", "counts"] = "analog",
    cycles: int | None = None,
    gain_v: float = 1.0,
    offset_v: float = 0.0,
    averaged_shots: int = 1,
    reference: ByPair | None = None,
    response: ArrayLike | None = None,
    response_path_m: float | None = None,
    response_path_sd_m: float = 0.0,
    response_t0_ps: ArrayLike | None = None,
    response_reference: ArrayLike | None = None,
    positions_m: ArrayLike | Mapping[int, ArrayLike] | None = None,
    laser_m: ArrayLike | None = None,
    sensor_m: ArrayLike | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Path:
    """Writes arrays as a campaign, for `run` and all commands: NumPy files, tables of captures, and campaign.toml.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder for the campaign; must be empty or absent. Its name becomes the campaign's.
    scene : array_like, shape (lit, seen, shots, samples) or (lit, seen, samples), or mapping
        Shots, mean profiles or photon counts: in V, or as codes of the converter. A pair whose samples are all NaN was
        not captured. A mapping holds an array (shots, samples) or (samples,) for each pair (lit, seen) of patches:
        ``{(i, i): counts[i - 1]}`` is a confocal scan.
    dt_ps : float
        Time between samples.
    t0_ps : float, array_like of shape (lit, seen) or (lit, seen, shots), or mapping
        Time of sample 0 after the trigger; for photon counts, of the middle of bin 0.
    lit, seen : sequence of int, optional
        Numbers of the patches along the first two axes; by default from 1. One number is one patch in both.
    kind : {"analog", "counts"}
        "counts": the samples are photons.
    cycles : int, optional
        Laser pulses behind each histogram; needed for "counts".
    gain_v, offset_v : float
        Volts a code, and volts at code 0.
    averaged_shots : int
        Shots that the instrument averaged into each record.
    reference : array_like or mapping, optional
        Of a second channel that sees the laser, shaped as `scene`: the pulse that marks time zero. Without it the
        trigger does, with its jitter.
    response : array_like, shape (shots, samples) or (samples,), optional
        The beam straight into the sensor, in the unit of `scene`; some hundred shots. `deconvolve` needs it.
    response_path_m, response_path_sd_m : float
        Length of the way of light from laser to sensor in that capture, and its standard deviation.
    response_t0_ps : float or array_like of shape (shots,), optional
        Time of sample 0 of the response; by default `t0_ps`, if that is one number.
    response_reference : array_like, optional
        Second channel of the response; needed with `reference`.
    positions_m : array_like, shape (patches, 3), or mapping, optional
        Positions of patches 1, 2, ..; a mapping has some of them by their numbers. They are anchors.
    laser_m, sensor_m : array_like, shape (3,), optional
        Positions of laser and sensor; by default both are at the origin, or the sensor is where the laser is.
    settings : mapping, optional
        Further keys of campaign.toml, by heading: ``{"campaign": {"group_index": 1.0}, "hidden": {"count": 1},
        "patches": {3: {"sd_m": 0.01}}, "sensors": {"s1": {"gate_ps": 300}}}``. The sensor is ``s1``.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    CampaignError
        If the folder is in use, or a value is none that campaign.toml may have. In the second case the files stay: fix
        campaign.toml, or remove the folder.
    ValueError
        If the arrays contradict one another, or a value is not finite.

    Notes
    -----
    All keys of campaign.toml, which may be edited afterwards: docs/guide/files.md of the project.
    """
    root = Path(folder)
    if root.exists() and any(root.iterdir()):
        raise CampaignError(f"{root} is not empty; choose another folder, or remove it")
    numbers = _numbers(scene, lit, seen)
    # `[()]` makes a number of an array without axes.
    starts = t0_ps if isinstance(t0_ps, Mapping) else np.asarray(t0_ps, dtype=float)[()]
    scenes = list(_scene(scene, starts, reference, numbers, kind))
    rules: list[tuple[str, list[Recording], dict[str, float]]] = [("scene", scenes, {"averaged_shots": averaged_shots})]
    if response is not None:
        if response_path_m is None:
            raise ValueError("response needs response_path_m, the length of its way from laser to sensor")
        if (reference is None) != (response_reference is None):
            raise ValueError("give both reference and response_reference, or neither: they mark the same time zero")
        if response_t0_ps is None:
            if not isinstance(starts, float):
                raise ValueError("t0_ps is not one number; give response_t0_ps too")
            response_t0_ps = starts
        start_ps, second = np.asarray(response_t0_ps, dtype=float), response_reference
        recording = _recording("raw/response.npy", response, start_ps, second, {}, kind)
        path = {"path_m": response_path_m}
        if response_path_sd_m:
            path["path_sd_m"] = response_path_sd_m
        rules.append(("response", [recording], path))
    document = _document(root, kind, cycles, _positions(positions_m), laser_m, sensor_m)
    scale = {"dt_ps": dt_ps, "gain_v": gain_v, "offset_v": offset_v}
    for role, recordings, keys in rules:
        document["captures"].append({"role": role, "table": f"{role}.csv", **scale, **keys})
        _write(root, f"{role}.csv", recordings)
    text = _toml(_merged(document, settings or {}))
    root.joinpath("campaign.toml").write_text(text, encoding="utf-8")  # last: a folder without it is no campaign
    load_campaign(root)
    return root


def _numbers(scene: ByPair, lit: Sequence[int] | None, seen: Sequence[int] | None) -> list[Pair | None]:
    """The pair of patches of each place of the first two axes; nothing for a mapping, which names pairs itself."""
    if isinstance(scene, Mapping):
        if lit is not None or seen is not None:
            raise ValueError("a mapping names its pairs itself; leave out lit and seen")
        return []
    shape = _shape(scene)
    if len(shape) not in (3, 4):
        raise ValueError(f"scene has shape {shape}; give (lit, seen, shots, samples) or (lit, seen, samples)")
    axes = [range(1, count + 1) if given is None else given for count, given in zip(shape, (lit, seen))]
    for name, count, axis in zip(("lit", "seen"), shape, axes):
        if len(axis) != count or len(set(axis)) != count:
            raise ValueError(f"{name} is {list(axis)}; {count} different numbers of patches are needed")
    return [(int(a), int(b)) for a in axes[0] for b in axes[1]]


def _by_pair(name: str, values: ByPair, numbers: list[Pair | None]) -> Mapping[Pair, ArrayLike]:
    """Values of each pair: a mapping as it is, an array by its first two axes."""
    if isinstance(values, Mapping):
        return values
    array = np.asarray(values)
    pairs = [pair for pair in numbers if pair is not None]
    if array.ndim < 2 or array.shape[0] * array.shape[1] != len(pairs) or not pairs:
        problem = "it must have the axes (lit, seen, ..) of scene, or be a mapping"
        raise ValueError(f"{name} has shape {array.shape}; {problem}")
    return {pair: array[divmod(n, array.shape[1])] for n, pair in enumerate(pairs)}


def _scene(
    scene: ByPair, t0_ps: Any, reference: ByPair | None, numbers: list[Pair | None], kind: str
) -> Iterator[Recording]:
    """The recordings of the pairs that were captured."""
    samples = _by_pair("scene", scene, numbers)
    starts = None if isinstance(t0_ps, float) else _by_pair("t0_ps", t0_ps, numbers)
    second = None if reference is None else _by_pair("reference", reference, numbers)
    for pair, values in samples.items():
        array = np.asarray(values)
        if array.dtype.kind == "f" and np.isnan(array).all():
            continue
        lacks = [name for name, by in (("t0_ps", starts), ("reference", second)) if by is not None and pair not in by]
        if lacks:
            raise ValueError(f"{lacks[0]} has no value for the pair {pair}")
        start_ps = np.asarray(t0_ps if starts is None else starts[pair], dtype=float)
        file = f"raw/scene/L{pair[0]}_P{pair[1]}.npy"
        columns = {"lit": int(pair[0]), "seen": int(pair[1])}
        yield _recording(file, array, start_ps, None if second is None else second[pair], columns, kind)


def _recording(
    file: str, samples: ArrayLike, t0_ps: Array, reference: ArrayLike | None, columns: dict[str, int], kind: str
) -> Recording:
    records = _records(file, samples, kind)
    second = None if reference is None else _records(f"reference of {file}", reference, "analog")
    if second is not None and len(second) != len(records):
        raise ValueError(f"{file}: there are {len(records)} shots, and {len(second)} of the reference")
    if t0_ps.shape not in ((), (len(records),)) or not np.isfinite(t0_ps).all():
        wanted = f"give one finite time, or one for each of {len(records)} shots"
        raise ValueError(f"{file}: t0_ps has shape {t0_ps.shape}; {wanted}")
    return Recording(file, records, t0_ps, second, columns)


def _records(name: str, samples: ArrayLike, kind: str) -> Array:
    """Records [shot, sample] of a type that a file may have."""
    array = np.atleast_2d(np.asarray(samples))
    if array.ndim != 2 or array.size == 0:
        raise ValueError(f"{name} has shape {_shape(samples)}; give (shots, samples) or (samples,)")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite; leave out these shots, or set all of a pair to NaN")
    if kind == "counts":
        whole = array.astype(np.int32)
        if not np.array_equal(whole, array) or whole.min() < 0:
            raise ValueError(f"{name} has values that are no numbers of photons")
        return whole
    kept: Array = array if str(array.dtype) in STORED else array.astype(np.float64)
    return kept


def _shape(values: Any) -> tuple[int, ...]:
    return np.asarray(values).shape


def _write(root: Path, table: str, recordings: list[Recording]) -> None:
    """The files of recordings, and the table that lists them: a row a file, or a row a shot where they have times."""
    if not recordings:
        raise ValueError("scene has no pair with samples")
    rows: list[dict[str, object]] = []
    for recording in recordings:
        path = root / recording.file
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, recording.samples)
        row: dict[str, object] = {"file": recording.file, **recording.columns}
        if recording.reference is not None:
            row["reference_file"] = recording.file.replace(".npy", "_reference.npy")
            np.save(root / str(row["reference_file"]), recording.reference)
        if recording.t0_ps.ndim == 0:
            rows.append({**row, "t0_ps": float(recording.t0_ps)})
            continue
        is_one = len(recording.t0_ps) == 1  # a file with a single record has no segments
        for shot, start_ps in enumerate(recording.t0_ps.tolist()):
            rows.append({**row, "segment": "" if is_one else shot, "shot": shot, "t0_ps": start_ps})
    columns = list(dict.fromkeys(column for row in rows for column in row))
    with root.joinpath(table).open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _positions(positions_m: ArrayLike | Mapping[int, ArrayLike] | None) -> dict[int, list[float]]:
    if positions_m is None:
        return {}
    if not isinstance(positions_m, Mapping):
        positions_m = dict(enumerate(np.asarray(positions_m, dtype=float), 1))
    return {int(patch): _place(f"position of patch {patch}", place) for patch, place in positions_m.items()}


def _place(name: str, place: ArrayLike) -> list[float]:
    point = np.asarray(place, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"{name} is {point.tolist()}; give x, y, z in metres")
    return point.tolist()


def _document(
    root: Path,
    kind: str,
    cycles: int | None,
    positions_m: Mapping[int, list[float]],
    laser_m: ArrayLike | None,
    sensor_m: ArrayLike | None,
) -> dict[str, Any]:
    """campaign.toml without captures."""
    sensor: dict[str, Any] = {}
    stations: dict[str, Any] = {}
    if kind not in ("analog", "counts"):
        raise ValueError(f'kind is {kind!r}; give "analog" or "counts"')
    if (kind == "counts") != (cycles is not None):
        raise ValueError('cycles, the laser pulses behind each histogram, goes with kind = "counts"')
    if kind == "counts":
        sensor |= {"kind": "counts", "cycles": cycles}
    if laser_m is not None:
        stations["laser"] = {"position_m": _place("laser_m", laser_m)}
    if sensor_m is not None:
        if laser_m is None:
            raise ValueError("sensor_m needs laser_m: else the laser would be at the origin")
        stations[SENSOR] = {"position_m": _place("sensor_m", sensor_m)}
        sensor["station"] = SENSOR
    return {
        # A name has letters, digits and hyphens, and begins with one of the first two.
        "campaign": {"name": re.sub("[^A-Za-z0-9]+", "-", root.resolve().name).strip("-")[:80] or "campaign"},
        "stations": stations,
        "sensors": {SENSOR: sensor},
        "patches": {str(patch): {"position_m": place} for patch, place in positions_m.items()},
        "captures": [],
    }


def _merged(document: dict[str, Any], settings: Mapping[Any, Any]) -> dict[str, Any]:
    """The document with further keys; those of headings that it has are added to them."""
    merged = dict(document)
    for key, value in settings.items():
        name, present = str(key), merged.get(str(key))
        if isinstance(present, dict) and isinstance(value, Mapping):
            merged[name] = _merged(cast("dict[str, Any]", present), cast("Mapping[Any, Any]", value))
        elif isinstance(present, list):
            merged[name] = [*present, *value]
        else:
            merged[name] = value
    return merged


def _toml(document: Mapping[str, Any]) -> str:
    """The text of campaign.toml: a line for each heading."""
    lines: list[str] = []
    for name, value in document.items():
        if name in ("stations", "sensors", "patches", "views"):
            lines += [f"{name}.{json.dumps(str(key))} = {_value(table)}" for key, table in value.items()]
        elif isinstance(value, list):
            lines += [f"{name} = [", *(f"  {_value(table)}," for table in cast("list[Any]", value)), "]"]
        else:
            lines.append(f"{name} = {_value(value)}")
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """A value as TOML has it: tables inline; scalars and lists have the same text in JSON."""
    if isinstance(value, Mapping):
        table = cast("Mapping[object, Any]", value)
        pairs = [f"{json.dumps(str(key))} = {_value(inner)}" for key, inner in table.items()]
        return f"{{ {', '.join(pairs)} }}" if pairs else "{}"
    if isinstance(value, (np.ndarray, np.generic)):
        return _value(cast("Any", value).tolist())
    try:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"settings: {value!r} is no value of campaign.toml: {error}") from error

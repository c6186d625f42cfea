"""Waveforms against the command `inspect`, and against files that the tests write themselves."""

from __future__ import annotations

import hashlib
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from conftest import command

import periscope

FACTS = {
    "format": "format",
    "kind": "kind",
    "instrument": "instrument",
    "channel": "channel",
    "segment": "segment",
    "dt_s": "dt_s",
    "t0_s": "t0_s",
    "t0_nominal": "t0_nominal",
    "unit": "unit",
    "gain": "header_gain",
    "offset": "header_offset",
    "acquired_at": "acquired_at",
    "remarks": "remarks",
}


def recordings(samples: Path) -> list[Path]:
    reference = json.loads((samples / "reference.json").read_text())
    entries = [entry for part in ("files", "derived") for entry in reference[part]]
    return sorted({samples / entry["file"] for entry in entries})


def test_real_files_have_the_samples_and_facts_that_inspect_prints(samples: Path) -> None:
    waveforms = 0
    for path in recordings(samples):
        try:
            ours = periscope.read(path)
        except periscope.FormatError:
            command("inspect", "--format", "json", path, codes=(1,))  # which refuses it too
            continue
        rows = json.loads(command("inspect", "--format", "json", path))
        assert len(ours) == len(rows), path
        for waveform, row in zip(ours, rows):
            volts = waveform.volts()
            assert hashlib.sha256(volts.astype("<f4").tobytes()).hexdigest() == row["sha256_f32le"], path
            assert {key: getattr(waveform, name) for key, name in FACTS.items()} == {key: row[key] for key in FACTS}
            assert len(waveform) == len(volts) == row["samples"]
            codes = waveform.codes()
            gain, offset = waveform.gain, waveform.offset
            scaled = codes if gain is None or offset is None else gain * codes.astype(float) + offset
            np.testing.assert_array_equal(scaled, volts, err_msg=str(path))
            waveforms += 1
    assert waveforms > 100


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    path = tmp_path / "pulse.csv"
    rows = [f"{n * 5e-10 - 1e-9:e},{value}" for n, value in enumerate([0.0, 0.02, 0.31, 0.12])]
    path.write_text("time (s),value (V)\n" + "\n".join(rows) + "\n")
    return path


def test_a_text_file_has_times_and_volts(csv: Path) -> None:
    (waveform,) = periscope.read(csv)
    np.testing.assert_array_equal(waveform.volts(), [0.0, 0.02, 0.31, 0.12])
    np.testing.assert_allclose(waveform.time_ps(), [-1000.0, -500.0, 0.0, 500.0], atol=1e-9)
    assert waveform.dt_ps == pytest.approx(500.0) and waveform.unit == "V"


def test_part_of_a_record_is_that_part(csv: Path) -> None:
    (waveform,) = periscope.read(csv)
    np.testing.assert_array_equal(waveform.volts(1, 3), [0.02, 0.31])
    np.testing.assert_allclose(waveform.time_ps(2), [0.0, 500.0], atol=1e-9)
    assert len(waveform.codes(4)) == 0
    with pytest.raises(IndexError, match="samples 2 to 5 are asked for"):
        waveform.volts(2, 5)


@pytest.mark.parametrize("dtype", ["i1", "u1", "<i2", ">i2", "<u2", "<i4", "<f4", "<f8"])
def test_arrays_of_every_type_come_back(tmp_path: Path, dtype: str, rng: np.random.Generator) -> None:
    shots = rng.integers(0, 100, (5, 300)).astype(dtype)
    np.save(tmp_path / "shots.npy", shots)
    waveforms = periscope.read(tmp_path / "shots.npy")
    assert len(waveforms) == 5
    codes = waveforms.codes()
    assert codes.shape == (5, 300) and codes.dtype == shots.dtype.newbyteorder("<")
    np.testing.assert_array_equal(codes, shots)
    np.testing.assert_array_equal(waveforms[1:3].codes(10, 20), shots[1:3, 10:20])
    np.testing.assert_array_equal(waveforms[-1].codes(), shots[-1])
    np.testing.assert_array_equal(waveforms.volts(), shots.astype(float))
    codes[0, 0] = 1  # it is the caller's own


def test_segments_of_a_campaign_file_have_their_own_times(campaign: Path) -> None:
    path = next(campaign.rglob("*.trc"))
    rows = json.loads(command("inspect", "--format", "json", path))
    shots = periscope.read(path)
    np.testing.assert_allclose(shots.t0_ps, [1e12 * row["t0_s"] for row in rows], rtol=1e-15)
    assert len(set(shots.t0_ps)) > 1
    assert [len(shots), shots.channels] == [len(rows), [rows[0]["channel"]]]
    assert len(shots.channel(shots.channels[0])) == len(shots)
    with pytest.raises(ValueError, match="its channels are"):
        shots.channel("no such channel")


def test_a_broken_file_says_what_where_and_how_to_fix(campaign: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.trc"
    broken.write_bytes(next(campaign.rglob("*.trc")).read_bytes()[:200])
    with pytest.raises(periscope.FormatError, match="copy it from the instrument again") as caught:
        periscope.read(broken)
    error = caught.value
    assert error.file == str(broken) and error.byte_offset is not None and error.line is None
    assert isinstance(error, periscope.PeriscopeError)
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.file, again.byte_offset) == (str(error), error.file, error.byte_offset)
    broken.write_text("time,volts\n0,1\n1,oops\n")
    with pytest.raises(periscope.FormatError):
        periscope.read(broken)


def test_what_the_system_refuses_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        periscope.read(tmp_path / "absent.trc")
    assert caught.value.filename == str(tmp_path / "absent.trc")

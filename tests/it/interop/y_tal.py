"""What y-tal, SciPy, plyfile and laspy say to files: called by y_tal.rs with a verb and files."""

import csv
import sys
import tomllib
from pathlib import Path

import h5py
import numpy as np
import tal.io
from tal.enums import FileFormat, GridFormat, HFormat, VolumeFormat
from tal.io.capture_data import NLOSCaptureData, read_hdf5
from tal.io.format import convert_dict, detect_dict_format

LIGHT = 2.99792458e-4  # m/ps
BINS, SIDE, DT_M = 60, 3, 16 * LIGHT
LASER, SENSOR = np.array([-0.5, 0.1, 1.0]), np.array([0.6, 0.0, 0.9])


def grid(side, z=0.0):
    along = np.linspace(-0.5, 0.5, side)
    return np.stack(np.meshgrid(along, along, [z], indexing="ij"), -1)[:, :, 0, :]


def counts(shape):
    return np.random.default_rng(1).poisson(5.0, shape)


def tal_capture(h_format, lit, seen, h, grid_format, with_legs=True):
    data = NLOSCaptureData()
    data.H, data.H_format = h, h_format
    data.sensor_xyz, data.laser_xyz = SENSOR, LASER
    data.sensor_grid_xyz, data.laser_grid_xyz = seen, lit
    data.sensor_grid_normals, data.laser_grid_normals = np.zeros_like(seen), np.zeros_like(lit)
    data.sensor_grid_normals[..., 2] = data.laser_grid_normals[..., 2] = 1.0
    data.sensor_grid_format = data.laser_grid_format = grid_format
    data.delta_t, data.t_start, data.t_accounts_first_and_last_bounces = DT_M, 0.75, with_legs
    data.scene_info = {"original_format": "made for a test"}
    return data


def make():
    wall, points = grid(SIDE), grid(SIDE).reshape(-1, 3)
    xy, n3 = GridFormat.X_Y_3, GridFormat.N_3
    one = np.array([[[0.1, 0.03, 0.0]]])
    square = (BINS, SIDE, SIDE)
    captures = {
        "confocal": (tal_capture(HFormat.T_Sx_Sy, wall, wall, counts(square).astype(np.float32), xy, False), 0),
        "packed": (tal_capture(HFormat.T_Sx_Sy, wall, wall, counts(square).astype(np.float64), xy), 9),
        "list": (tal_capture(HFormat.T_Si, points[:7], points[:7], counts((BINS, 7)), n3), 4),
        "one-lit": (tal_capture(HFormat.T_Sx_Sy, one, wall, counts(square).astype(np.uint16), xy), 1),
        "all": (tal_capture(HFormat.T_Lx_Ly_Sx_Sy, wall, wall, counts((BINS,) + (SIDE,) * 4), xy), 1),
        "all-list": (tal_capture(HFormat.T_Li_Si, points[:4], points[:6], counts((BINS, 4, 6)), n3, False), 0),
    }
    for name, (capture, level) in captures.items():
        tal.io.write_capture(f"{name}.hdf5", capture, compression_level=level)
    z_nlos("z-nlos", (2, BINS, 6, SIDE, SIDE, 2, 2), 2)
    z_nlos("z-nlos-confocal", (2, BINS, 6, SIDE, SIDE), SIDE)
    from scipy.io import savemat

    scan = {"rect_data": counts((3, 4, BINS)).astype(np.float64), "width": 0.5, "note": "a text"}
    savemat("scan-5.mat", scan)
    savemat("scan-5-packed.mat", scan, do_compression=True)


def z_nlos(name, shape, lit):
    turned = lambda points: points.transpose()
    with h5py.File(f"{name}.hdf5", "w") as file:
        file["data"] = counts(shape).astype(np.float32)
        file["cameraPosition"], file["laserPosition"] = SENSOR.reshape(3, 1), LASER.reshape(3, 1)
        for kind, side in [("camera", SIDE), ("laser", lit)]:
            file[f"{kind}GridPositions"] = turned(grid(side))
            file[f"{kind}GridNormals"] = turned(np.broadcast_to([0.0, 0.0, 1.0], (side, side, 3)))
        file["deltaT"], file["t0"] = DT_M, 0.75
        file["hiddenVolumePosition"] = file["hiddenVolumeRotation"] = np.zeros(3)
        file["hiddenVolumeSize"] = 1.0


def read(name):
    """A capture as y-tal reads it; of other formats its own conversion, since `read_capture` of 0.20 fails on what that gives (`scene_info`)."""
    raw = read_hdf5(name)
    if detect_dict_format(raw) == FileFormat.HDF5_TAL:
        return tal.io.read_capture(name)
    data = NLOSCaptureData()
    for key, value in convert_dict(raw, FileFormat.HDF5_TAL).items():
        setattr(data, key, value)
    return data


def records(data):
    """Lit point, seen point and histogram of each pair, as y-tal means them."""
    lit, seen = data.laser_grid_xyz.reshape(-1, 3), data.sensor_grid_xyz.reshape(-1, 3)
    if data.H_format in (HFormat.T_Lx_Ly_Sx_Sy, HFormat.T_Li_Si):
        h = data.H.reshape(data.H.shape[0], len(lit), len(seen))
        return [(lit[i], seen[j], h[:, i, j]) for i in range(len(lit)) for j in range(len(seen))]
    h = data.H.reshape(data.H.shape[0], len(seen))
    return [(lit[0] if len(lit) == 1 else lit[j], seen[j], h[:, j]) for j in range(len(seen))]


def campaign_records(folder):
    """The same of a campaign folder, with the time of the first bin's middle in ps."""
    campaign = tomllib.loads((folder / "campaign.toml").read_text())
    histograms = np.load(folder / "raw/histograms.npy")
    for row in csv.DictReader(open(folder / "captures.csv")):
        place = lambda name: np.array(campaign["patches"][row[name]]["position_m"])
        yield place("lit"), place("seen"), histograms[int(row["segment"])], float(row["t0_ps"])


def campaign(capture, folder):
    data, folder = read(capture), Path(folder)
    ours, theirs = list(campaign_records(folder)), records(data)
    assert len(ours) == len(theirs)
    told = tomllib.loads((folder / "campaign.toml").read_text())
    assert np.allclose(told["stations"]["laser"]["position_m"], LASER)
    assert np.allclose(told["stations"]["sensor"]["position_m"], SENSOR)
    assert told["sensors"]["sensor"]["kind"] == "counts"
    assert abs(told["captures"][0]["dt_ps"] * LIGHT - data.delta_t) < 1e-9
    for (lit, seen, histogram, t0_ps), (at, to, expected) in zip(ours, theirs):
        assert np.allclose(lit, at) and np.allclose(seen, to), (lit, at, seen, to)
        assert np.array_equal(histogram, expected)
        legs = 0.0 if data.t_accounts_first_and_last_bounces else np.linalg.norm(LASER - at) + np.linalg.norm(to - SENSOR)
        assert abs(t0_ps * LIGHT - (data.t_start + 0.5 * data.delta_t + legs)) < 1e-6


def same(capture, back):
    one, other = read(capture), tal.io.read_capture(back)
    assert other.H_format == one.H_format and other.H.shape == one.H.shape, (other.H_format, other.H.shape)
    assert np.array_equal(other.H, one.H)
    assert other.sensor_grid_format == one.sensor_grid_format and other.laser_grid_format == one.laser_grid_format
    for name in ["sensor_xyz", "laser_xyz", "sensor_grid_xyz", "laser_grid_xyz", "sensor_grid_normals", "laser_grid_normals"]:
        assert getattr(other, name).shape == getattr(one, name).shape, name
        assert np.allclose(getattr(other, name), getattr(one, name), atol=1e-7), name
    assert abs(other.delta_t - one.delta_t) < 1e-12 and abs(other.t_start - one.t_start) < 1e-9
    assert bool(other.t_accounts_first_and_last_bounces) == bool(one.t_accounts_first_and_last_bounces)
    assert other.is_confocal() == one.is_confocal()


def scan(folder):
    expected = counts((3, 4, BINS))
    rows = list(campaign_records(Path(folder)))
    assert len(rows) == 12
    for lit, seen, histogram, _ in rows:
        assert np.array_equal(lit, seen)
        x, y = round((lit[0] + 0.5) * 2), round((lit[1] + 0.5) * 3)
        assert np.array_equal(histogram, expected[x, y])


def ply(cloud, capture):
    from plyfile import PlyData

    vertices = PlyData.read(cloud)["vertex"]
    wall = tal.io.read_capture(capture).sensor_grid_xyz.reshape(-1, 3)
    assert np.allclose(np.stack([vertices[axis] for axis in "xyz"], -1), wall)
    assert list(vertices["patch"]) == list(range(1, len(wall) + 1)) and not vertices["kind"].any()
    assert np.allclose(vertices["cov_xx_m2"], 1e-12) and np.allclose(vertices["sd_m"], 3**0.5 * 1e-6)


def volume(name, array, column, row, depth, x, y, z):
    """A volume as y-tal reads it: that of the array, with the middle of a voxel at its place."""
    raw, expected = read_hdf5(name), np.load(array)
    values, places = raw["reconstruction"], raw["volume_xyz"]
    assert raw["volume_format"] == VolumeFormat.X_Y_Z_3 and places.shape == (*values.shape, 3)
    assert np.array_equal(values, expected.transpose(1, 0, 2))
    place = places[int(column), int(row), int(depth)]
    assert np.allclose(place, np.array([x, y, z], float), atol=1e-6), place


def points(path):
    """Two lit and three seen points, four bins: the number of a bin is 100 lit + 10 seen + bin. Integers of 64 bits."""
    lit, seen, bin = np.meshgrid(np.arange(2), np.arange(3), np.arange(4), indexing="ij")
    place = lambda count: np.stack([0.1 * np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
    counts = np.asfortranarray(100 * lit + 10 * seen + bin)
    np.savez_compressed(path, counts=counts, lit_m=place(2), seen_m=place(3), dt_ps=16.0, start_ps=7)


def cloud(las, echoes):
    """A cloud of echoes, against rows of x, y, z, standard deviation of the range, number of the echo, and of echoes."""
    import laspy

    points = laspy.read(las)
    rows = np.loadtxt(echoes, delimiter=",")
    places = np.stack([points.x, points.y, points.z], axis=1)
    assert places.shape == (len(rows), 3), places.shape
    assert np.abs(places - rows[:, :3]).max() < 0.51 * points.header.scales.max()
    assert np.allclose(points["range_sd_m"], rows[:, 3], rtol=1e-6)
    assert np.array_equal(points.return_number, rows[:, 4]) and np.array_equal(points.number_of_returns, rows[:, 5])


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])

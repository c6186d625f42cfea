"""Shows a result folder in rerun's viewer (`pip install rerun-sdk`): patches with their error ellipsoids, points of hidden
surfaces and the surfaces between them coloured by standard deviation, and the decisions of the run as text.

Ellipsoids are two standard deviations, true to scale: come near, or hide the points. With FILE.rrd, a recording is written
in place of a window; `rerun FILE.rrd` opens it.

    python rerun-viewer.py RESULTS [FILE.rrd]
"""

import os
import sys

import numpy as np
import polars as pl

COLOURS = {"visible": [70, 130, 200], "hidden": [230, 120, 20], "mirror": [150, 90, 200]}
COVARIANCE = ["cov_xx_m2", "cov_xy_m2", "cov_xz_m2", "cov_xy_m2", "cov_yy_m2", "cov_yz_m2", "cov_xz_m2", "cov_yz_m2", "cov_zz_m2"]


def table(results, *names):
    """The first of these tables that has rows, else None."""
    for name in names:
        folder = os.path.join(results, name)
        rows = pl.read_parquet(f"{folder}/*.parquet") if os.path.isdir(folder) and os.listdir(folder) else None
        if rows is not None and len(rows):
            return rows
    return None


def places(rows):
    return rows.select("x_m", "y_m", "z_m").to_numpy()


def shades(sd_m):
    """Blue the surest, red from twice the median on."""
    red = np.minimum(127.5 * sd_m / np.median(sd_m), 255.0)
    return np.stack([red, np.full_like(red, 60.0), 255.0 - red], axis=1).astype(np.uint8)


def quaternion(axes):
    """x, y, z, w of a rotation whose matrix has these columns."""
    w = np.sqrt(max(0.0, 1.0 + np.trace(axes))) / 2.0
    if w > 1e-6:
        return [*(np.array([axes[2, 1] - axes[1, 2], axes[0, 2] - axes[2, 0], axes[1, 0] - axes[0, 1]]) / (4.0 * w)), w]
    k = int(np.argmax(np.diag(axes)))
    axis = (axes[:, k] + np.eye(3)[k]) / np.sqrt(2.0 * (1.0 + axes[k, k]))
    return [*axis, 0.0]


def ellipsoids(rows):
    """Half axes of two standard deviations, and rotations."""
    covariances_m2 = np.stack([rows[name].to_numpy() for name in COVARIANCE], axis=1).reshape(-1, 3, 3)
    squares_m2, axes = np.linalg.eigh(covariances_m2)
    axes = axes * np.linalg.det(axes)[:, None, None]  # turns, no mirrors
    return 2.0 * np.sqrt(np.maximum(squares_m2, 0.0)), [quaternion(one) for one in axes]


def triangles(nodes):
    """Faces between neighbouring nodes of a mesh."""
    number = {place: n for n, place in enumerate(nodes.select("grid_row", "grid_column").iter_rows())}
    faces = []
    for row, column in {(row - up, column - right) for row, column in number for up in (0, 1) for right in (0, 1)}:
        around = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
        corners = [number[place] for place in around if place in number]
        faces += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return sorted(faces)


def things(results):
    """What is shown: its path in the viewer, its archetype, and the values of that."""
    patches = table(results, "all_patches", "patches", "anchors")
    if patches is not None:
        patches = patches.filter(pl.col("alternative") == 0)
        for (kind,), rows in patches.group_by("kind", maintain_order=True):
            labels = [f"{patch}" for patch in rows["patch"]] if len(rows) <= 60 else None
            yield f"patches/{kind}", "Points3D", {"positions": places(rows), "colors": COLOURS[kind], "labels": labels, "radii": 0.004}
            known = rows.filter(pl.col("cov_xx_m2") > 0.0)
            if len(known):
                half_sizes, quaternions = ellipsoids(known)
                shown = {"centers": places(known), "half_sizes": half_sizes, "quaternions": quaternions, "colors": COLOURS[kind]}
                yield f"patches/{kind}/two_sd", "Ellipsoids3D", shown
    points = table(results, "shapes.points", "surface")
    if points is not None:
        shown = {"positions": places(points), "colors": shades(points["sd_m"].to_numpy()), "radii": 0.002}
        yield "surface/points", "Points3D", shown
    vertices = table(results, "meshes.vertices")
    for (mesh,), nodes in [] if vertices is None else vertices.group_by("mesh", maintain_order=True):
        normals = nodes.select("normal_x", "normal_y", "normal_z").to_numpy()
        shown = {"vertex_positions": places(nodes), "vertex_normals": normals, "triangle_indices": triangles(nodes)}
        yield f"surface/mesh_{mesh}", "Mesh3D", shown | {"vertex_colors": shades(nodes["sd_m"].to_numpy())}
    decisions = table(results, "decisions")
    if decisions is not None:
        rows = [f"- **{what}**: {chosen} ({evidence})" for what, chosen, evidence in decisions.select("what", "chosen", "evidence").iter_rows()]
        yield "decisions", "TextDocument", {"text": "\n".join(rows), "media_type": "text/markdown"}


def main(results, recording=None):
    import rerun

    rerun.init("periscope", spawn=recording is None)
    if recording is not None:
        rerun.save(recording)
    count = 0
    for path, archetype, values in things(results):
        rerun.log(path, getattr(rerun, archetype)(**values), static=True)
        count += 1
    if count == 0:
        sys.exit(f"{results}: no patches, no surface and no decisions in this folder")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""A campaign, and what a single run makes of it.

PERISCOPE names the program. The scene is that of `periscope demo` with a fifth of its shots, cut into a part a pair of patches.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = os.environ["PERISCOPE"]
PIPELINE = ROOT / "pipelines/scene.toml"
SHARDS = 24


class Lab:
    """A campaign, what a single run makes of it, and a program that writes down what it is asked for."""

    def __init__(self, folder: Path) -> None:
        """Simulates the campaign."""
        self.folder = folder
        self.campaign = folder / "campaign"
        self.log = folder / "log"
        text = (ROOT / "pipelines/scenes/around-the-corner.toml").read_text()
        scene = folder / "scene.toml"
        scene.write_text(text.replace("shots = 200\n", "shots = 40\n").replace("response_shots = 2000", "response_shots = 200"))
        subprocess.run([PROGRAM, "simulate", scene, "--out", self.campaign], check=True, capture_output=True)
        keys = self.campaign / "campaign.toml"
        keys.write_text(keys.read_text().replace("[campaign]\n", "[campaign]\npart_bytes = 1\n", 1))
        self.single = folder / "single"
        subprocess.run([PROGRAM, "run", PIPELINE, "--campaign", self.campaign, "--out", self.single], check=True, capture_output=True)
        # Shards of a third of a second, so that there is something to kill.
        self.program = folder / "periscope"
        lines = ["#!/bin/sh", f'echo "$@" >> {self.log}', '[ "$1" = run-shard ] && sleep 0.3', f'exec {PROGRAM} "$@"', ""]
        self.program.write_text("\n".join(lines))
        self.program.chmod(0o755)

    def words(self, out: str, workers: int) -> list[str]:
        """Arguments of the driver."""
        where = ["--campaign", str(self.campaign), "--out", str(self.folder / out)]
        return [str(PIPELINE), *where, "--shards", str(SHARDS), "--workers", str(workers), "--periscope", str(self.program)]

    def driver(self, out: str) -> subprocess.Popen[str]:
        """Starts the driver as a process of its own."""
        self.log.unlink(missing_ok=True)
        command = [sys.executable, str(ROOT / "pipelines/cluster/dask_run.py"), *self.words(out, 3)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def asked(self) -> list[str]:
        """Keys of the shards that the program was asked for, in order."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return [line.split()[1] for line in lines if line.startswith("run-shard")]

    def wait_for(self, count: int) -> None:
        """Waits until so many shards have begun."""
        while len(self.asked()) < count:
            time.sleep(0.02)


def files(out: Path) -> dict[str, str]:
    """Every table file of a result folder, through its views and on its shelf, with its digest."""
    found = [Path(folder) / name for folder, _, names in os.walk(out, followlinks=True) for name in names if name.endswith(".parquet")]
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def finished(out: Path) -> dict[Path, int]:
    """Records of finished parts, and when they were written."""
    return {path: path.stat().st_mtime_ns for path in out.glob(".shelf/*/part-*.json")}

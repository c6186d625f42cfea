"""The Snakemake file, for real, and the Slurm script, with a stand-in for `sbatch` that runs tasks at once: the bytes of a single run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from lab import PIPELINE, PROGRAM, ROOT, SHARDS, Lab, files

SBATCH = """#!/bin/sh
last=0
while :; do
    case "$1" in --array=0-*) last=${1#--array=0-} ;; --*) ;; *) break ;; esac
    shift
done
for n in $(seq 0 "$last"); do SLURM_ARRAY_TASK_ID=$n "$@" >> sbatch.log || exit 1; done
echo 4711
"""


def test_snakemake_makes_the_bytes_of_a_single_run_and_goes_on(lab: Lab) -> None:
    """And what it has made it does not make again."""
    out = lab.folder / "by-snakemake"
    config = [f"pipeline={PIPELINE}", f"campaign={lab.campaign}", f"out={out}", f"shards={SHARDS}", f"periscope={PROGRAM}"]
    snakefile = ROOT / "pipelines/cluster/Snakefile"
    command: list[str | Path] = [sys.executable, "-m", "snakemake", "--snakefile", snakefile, "--cores", "2", "--config", *config]
    for expected in ("(100%) done", "Nothing to be done"):
        ran = subprocess.run(command, cwd=lab.folder, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr
        assert expected in ran.stderr
    assert files(out) == files(lab.single)
    assert len(list((lab.folder / "by-snakemake.shards").glob("*.json"))) == SHARDS


def test_the_slurm_script_makes_the_bytes_of_a_single_run(lab: Lab) -> None:
    """An option of `plan` with a blank in it, and one of sbatch."""
    programs = lab.folder / "bin"
    programs.mkdir()
    (programs / "sbatch").write_text(SBATCH)
    (programs / "sbatch").chmod(0o755)
    (programs / "periscope").symlink_to(PROGRAM)
    script = ROOT / "pipelines/cluster/slurm.sh"
    plan: list[str | Path] = [PIPELINE, "--campaign", lab.campaign, "--set", "onsets.threshold_sigma = 5.0"]
    command = [script, "by-slurm", str(SHARDS), *plan, "--", "--cpus-per-task=1"]
    path = f"{programs}:{os.environ['PATH']}"
    ran = subprocess.run(command, cwd=lab.folder, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert files(lab.folder / "by-slurm") == files(lab.single)
    lines = (lab.folder / "sbatch.log").read_text().splitlines()
    assert sum(line.startswith('{"key":') for line in lines) == SHARDS

"""The Dask driver, over the program itself: workers and schedulers that are killed, cancelled jobs, and the bytes of a single run."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest
from distributed import Client, LocalCluster

import dask_run
from lab import PIPELINE, PROGRAM, SHARDS, Lab, files, finished


def test_a_worker_killed_at_a_third_costs_its_task_and_no_byte(lab: Lab, capfd: pytest.CaptureFixture[str]) -> None:
    """Three worker processes, 24 shards, SIGKILL."""
    lab.log.unlink(missing_ok=True)
    killed: list[str] = []

    def kill(client: Client) -> None:
        lab.wait_for(SHARDS // 3)
        address, tasks = next((address, tasks) for address, tasks in client.processing().items() if tasks)
        killed.extend(str(task) for task in tasks)
        os.kill(client.run(os.getpid, workers=[address])[address], signal.SIGKILL)

    def started(client: Client) -> None:
        client.wait_for_workers(3)
        threading.Thread(target=kill, args=(client,), daemon=True).start()

    begun = time.monotonic()
    assert dask_run.run(dask_run.parse(lab.words("killed", 3)), started) == 0
    asked = lab.asked()
    rerun = {key for key in asked if asked.count(key) > 1}
    assert len(set(asked)) == SHARDS
    assert 1 <= len(rerun) <= 2, rerun  # the one that ran, and one that had just ended there
    assert killed
    assert files(lab.folder / "killed") == files(lab.single)
    said = capfd.readouterr()
    assert "dashboard: http://" in said.err
    assert f"{SHARDS} of {SHARDS} shards" in said.err
    assert "patches" in said.out
    print(f"killed and rerun: {len(rerun)} of {SHARDS} shards, {time.monotonic() - begun:.1f} s")


def test_a_scheduler_killed_costs_what_was_under_way(lab: Lab) -> None:
    """The driver holds the scheduler; submitted again, it goes on."""
    out = lab.folder / "resubmitted"
    driver = lab.driver("resubmitted")
    lab.wait_for(SHARDS // 2)
    driver.kill()
    driver.wait()
    time.sleep(1.5)  # until what its workers had started has ended
    before = finished(out)
    assert before
    again = lab.driver("resubmitted")
    _, err = again.communicate()
    assert again.returncode == 0, err
    assert len(lab.asked()) <= SHARDS  # what is left is dealt anew, large parts by their shots
    assert all(path.stat().st_mtime_ns == made for path, made in before.items()), "finished parts are not written again"
    assert files(out) == files(lab.single)
    print(f"resubmitted: {len(lab.asked())} shards, {len(before)} parts of tables were finished")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_cancelled_job_leaves_nothing_that_runs_and_goes_on(lab: Lab, how: signal.Signals) -> None:
    """Ctrl-C."""
    out = lab.folder / f"cancelled-{how.name}"
    driver = lab.driver(out.name)
    lab.wait_for(SHARDS // 3)
    driver.send_signal(how)
    _, err = driver.communicate(timeout=60)
    assert driver.returncode == dask_run.INTERRUPTED, err
    assert "finished shards are kept" in err
    begun = len(lab.asked())
    time.sleep(1)
    assert len(lab.asked()) == begun < SHARDS
    # Alone: nothing holds the folder any more.
    run: list[str | Path] = [PROGRAM, "run", PIPELINE, "--campaign", lab.campaign, "--out", out]
    subprocess.run(run, check=True, capture_output=True)
    assert files(out) == files(lab.single)


def test_a_shard_that_always_fails_ends_the_job_and_is_named(lab: Lab) -> None:
    """Retries do not help here."""
    shards = dask_run.plan(dask_run.parse(lab.words("failing", 1)))
    bad = Path(shards[3].inputs[0])
    content = bad.read_bytes()
    try:
        driver = lab.driver("failing")
        lab.wait_for(2)
        bad.unlink()
        _, err = driver.communicate(timeout=120)
    finally:
        bad.write_bytes(content)
    assert driver.returncode == 1
    assert "run-shard" in err
    assert bad.name in err


def test_clusters_are_distinguished_and_ask_for_cores_and_memory(lab: Lab) -> None:
    """What would be handed to Slurm and HTCondor."""
    words = [*lab.words("out", 5), "--cores", "4", "--memory", "16GB"]
    for kind, expected in [("slurm", ["#SBATCH --cpus-per-task=4", "#SBATCH --mem=15G"]), ("htcondor", ["request_cpus = 4", "RequestMemory"])]:
        cluster = dask_run.cluster_of(dask_run.parse([*words, "--cluster", kind]))
        assert not isinstance(cluster, str)
        with cluster:
            script = cluster.job_script()  # type: ignore[attr-defined]  # of dask-jobqueue's clusters
        assert all(line in script for line in expected), script
    assert dask_run.cluster_of(dask_run.parse([*words, "--cluster", "tcp://host:8786"])) == "tcp://host:8786"
    with pytest.raises(dask_run.CommandError, match="give local, slurm, htcondor"):
        dask_run.cluster_of(dask_run.parse([*words, "--cluster", "cloud"]))


def test_progress_is_reported_in_words() -> None:
    """How far, how fast, how long still."""
    assert dask_run.progress(3, 24, 500_000_000, 4_000_000_000, 10.0) == "3 of 24 shards, 500.0 MB of 4.0 GB, 50.0 MB/s, 70 s left"
    assert dask_run.progress(24, 24, 12, 12, 0.5) == "24 of 24 shards, 12 B of 12 B, 24 B/s"


def test_a_cluster_that_runs_is_used_and_left_as_it_was(lab: Lab) -> None:
    """`--cluster` with the address of a scheduler."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        assert dask_run.run(dask_run.parse([*lab.words("elsewhere", 2), "--cluster", cluster.scheduler_address])) == 0
        with Client(cluster) as client:
            assert len(client.scheduler_info()["workers"]) == 2
    assert files(lab.folder / "elsewhere") == files(lab.single)

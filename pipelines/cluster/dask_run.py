#!/usr/bin/env python3
"""Computes campaigns on a Dask cluster: plan --shards, run-shard on every worker, gather.

    dask_run.py all-visible --campaign DIR --out DIR --shards 200 --cluster slurm --workers 50 --cores 4

Result folder and campaigns lie where all workers see them under the same path. Killed workers, tasks and runs cost what was under way: a shard that is
finished is never computed again. What is particular to a site (queue, account, walltime) stands in dask-jobqueue's own file, ~/.config/dask/jobqueue.yaml.
docs/scale.md has the rest.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, cast

from distributed import Client, Future, LocalCluster, WorkerPlugin, as_completed, get_worker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from distributed.deploy.cluster import Cluster

SOME_REJECTED = 3
"""Exit code of the program: done, but some input was rejected."""

INTERRUPTED = 130
"""Exit code of the program, and of this one: ended by Ctrl-C or SIGTERM."""

PLUGIN = "periscope"


@dataclass(frozen=True)
class Options:
    """The command line."""

    pipeline: str
    campaign: list[Path]
    out: Path
    shards: int
    until: str | None
    set: list[str]
    cluster: str
    workers: int
    cores: int
    memory: str
    retries: int
    periscope: str
    strict: bool


@dataclass(frozen=True)
class Shard:
    """A row of the plan."""

    key: str
    captures: int
    parts: int
    bytes: int
    inputs: list[str]


@dataclass(frozen=True)
class Ended:
    """What a command left: exit code, and what it printed."""

    code: int
    out: str
    err: str


class CommandError(RuntimeError):
    """A command of the program failed; the text is what it said."""


class Commands(WorkerPlugin):
    """Runs commands on a worker, and ends them when the worker or the job ends: a task that is cancelled knows nothing of it."""

    name = PLUGIN

    def __init__(self) -> None:
        self.running: set[subprocess.Popen[str]] = set()
        self.is_over = False
        self.lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        return {}

    def __setstate__(self, _: dict[str, Any]) -> None:
        Commands.__init__(self)

    def run(self, command: list[str]) -> Ended:
        """Runs a command to its end."""
        with self.lock:
            if self.is_over:
                return Ended(INTERRUPTED, "", "the job was cancelled")
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self.running.add(process)
        try:
            out, err = process.communicate()
        finally:
            with self.lock:
                self.running.discard(process)
        return Ended(process.returncode, out, err)

    def stop(self) -> int:
        """Asks what runs to end at the next batch, and starts nothing more; finished parts are kept. How many commands ran."""
        with self.lock:
            self.is_over = True
            for process in self.running:
                process.terminate()
            return len(self.running)

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  # distributed gives it
        """The worker ends in good order, as at the end of its walltime."""
        self.stop()


def on_worker(command: list[str]) -> Ended:
    """The task: a command on the worker that has it."""
    ended = cast("Commands", get_worker().plugins[PLUGIN]).run(command)
    if ended.code not in (0, SOME_REJECTED):
        raise CommandError(f"{' '.join(command)}: exit code {ended.code}: {ended.err.strip()}")
    return ended


def stop_commands(dask_worker: Any) -> int:
    """Run on every worker when the job is cancelled."""
    return cast("Commands", dask_worker.plugins[PLUGIN]).stop()


def plan(options: Options) -> list[Shard]:
    """Deals out what is missing; what shards stand beside, such as the calibration, is made here."""
    command = [options.periscope, "plan", options.pipeline, "--out", str(options.out), "--format", "json"]
    command += ["--shards", str(options.shards)]
    command += [word for folder in options.campaign for word in ("--campaign", str(folder))]
    command += [word for setting in options.set for word in ("--set", setting)]
    command += ["--until", options.until] if options.until else []
    planned = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if planned.returncode != 0:
        raise CommandError(f"`periscope plan` ended with exit code {planned.returncode}")
    names = [field.name for field in fields(Shard)]
    return [Shard(**{name: row[name] for name in names}) for row in json.loads(planned.stdout)]


def shard_command(options: Options, shard: Shard) -> list[str]:
    """The command that computes a shard."""
    where = ["--out", str(options.out.absolute()), "--threads", str(options.cores), "--progress", "none"]
    return [options.periscope, "run-shard", shard.key, *where]


def gather_command(options: Options) -> list[str]:
    """The command that ends the job."""
    where = ["--out", str(options.out.absolute()), "--threads", str(options.cores), "--progress", "none", "--wait"]
    return [options.periscope, "gather", *where, *(["--strict"] if options.strict else [])]


def cluster_of(options: Options) -> Cluster | str:
    """The cluster that `--cluster` names: one task a worker at a time, which uses `--cores` threads."""
    if options.cluster == "local":
        return LocalCluster(n_workers=options.workers, threads_per_worker=1, memory_limit=0, dashboard_address=":0")
    if options.cluster == "slurm":
        from dask_jobqueue.slurm import SLURMCluster

        return SLURMCluster(cores=1, processes=1, memory=options.memory, job_cpu=options.cores)
    if options.cluster == "htcondor":
        from dask_jobqueue.htcondor import HTCondorCluster

        condor = {"request_cpus": str(options.cores)}
        return HTCondorCluster(cores=1, processes=1, memory=options.memory, disk="1GB", job_extra_directives=condor)
    if "://" in options.cluster:
        return options.cluster
    raise CommandError(f"--cluster {options.cluster}: give local, slurm, htcondor, or the address of a scheduler, such as tcp://host:8786")


@contextmanager
def client_of(options: Options) -> Iterator[Client]:
    """A client whose workers can run commands; a cluster that was started for it goes with it."""
    cluster = cluster_of(options)
    if isinstance(cluster, str):
        with Client(cluster) as client:
            client.register_plugin(Commands())
            yield client
        return
    with cluster, Client(cluster) as client:
        client.register_plugin(Commands())
        if options.cluster != "local":
            cluster.scale(options.workers)
        yield client


def size(amount: float) -> str:
    """Bytes for people."""
    for factor, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if amount >= factor:
            return f"{amount / factor:.1f} {unit}"
    return f"{amount:.0f} B"


def progress(done: int, count: int, read: int, total: int, elapsed_s: float) -> str:
    """A line: how far, how fast, how long still."""
    rate = read / elapsed_s if elapsed_s > 0 else 0.0
    left = f", {(total - read) / rate:.0f} s left" if rate > 0 and read < total else ""
    return f"{done} of {count} shards, {size(read)} of {size(total)}, {size(rate)}/s{left}"


def say(text: str) -> None:
    """To people: standard error."""
    print(text, file=sys.stderr, flush=True)


def compute(client: Client, options: Options, shards: list[Shard]) -> None:
    """Runs all shards; tasks of workers that die, and those that fail, are run again."""
    started, read, total = time.monotonic(), 0, sum(shard.bytes for shard in shards)
    tasks: dict[Future[Ended], Shard] = {
        client.submit(on_worker, shard_command(options, shard), key=f"shard-{shard.key}", retries=options.retries, pure=False): shard for shard in shards
    }
    try:
        for done, task in enumerate(as_completed(list(tasks)), start=1):
            task.result()
            read += tasks.pop(task).bytes
            # What nobody holds is not made again with the worker that had it.
            task.release()
            say(progress(done, len(shards), read, total, time.monotonic() - started))
    except BaseException:
        # One failure that retries did not mend, or Ctrl-C: the others end at their next batch.
        client.cancel(list(tasks), force=True)
        client.run(stop_commands, on_error="ignore")
        raise


def gather(client: Client, options: Options) -> int:
    """Shows the tables, and runs what needs all captures: on a worker, as this machine may be one to log in to."""
    task = client.submit(on_worker, gather_command(options), key=f"gather-{time.time_ns()}", pure=False)
    try:
        ended: Ended = task.result()
    except BaseException:
        client.cancel([task], force=True)
        client.run(stop_commands, on_error="ignore")
        raise
    print(ended.out, end="", flush=True)
    if ended.err:
        say(ended.err.rstrip())
    return ended.code


def run(options: Options, started: Callable[[Client], None] = lambda _: None) -> int:
    """The whole job: its exit code. `started` is told the client before the first shard."""
    shards = plan(options)
    with client_of(options) as client:
        say(f"{len(shards)} shards; dashboard: {client.dashboard_link}")
        started(client)
        compute(client, options, shards)
        return gather(client, options)


def parse(words: list[str] | None = None) -> Options:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pipeline", help="pipeline: a name that `periscope pipelines` lists, or a file")
    parser.add_argument("--campaign", type=Path, action="append", required=True, help="campaign folder; may be given several times")
    parser.add_argument("--out", type=Path, required=True, help="result folder")
    parser.add_argument("--shards", type=int, required=True, help="shards at most: some four a worker or more")
    parser.add_argument("--until", help="stop after this table")
    parser.add_argument("--set", action="append", default=[], metavar="TABLE.PARAM=VALUE", help="change a parameter of the pipeline")
    parser.add_argument("--cluster", default="local", help="local, slurm, htcondor, or the address of a scheduler (default: local)")
    parser.add_argument("--workers", type=int, default=2, help="workers, each a job of the queue (default: 2)")
    parser.add_argument("--cores", type=int, default=1, help="cores of each (default: 1)")
    parser.add_argument("--memory", default="4GB", help="memory of each, asked of the queue (default: 4GB)")
    parser.add_argument("--retries", type=int, default=3, help="how often a shard that fails is run again (default: 3)")
    parser.add_argument("--periscope", default="periscope", help="the program, where workers find it (default: periscope)")
    parser.add_argument("--strict", action="store_true", help="exit code 1 when anything was rejected")
    return Options(**vars(parser.parse_args(words)))


def interrupt(*_: object) -> NoReturn:
    """SIGTERM ends the job as Ctrl-C does."""
    raise KeyboardInterrupt


def main() -> int:
    """The command."""
    signal.signal(signal.SIGTERM, interrupt)
    try:
        return run(parse())
    except CommandError as error:
        say(f"error: {error}")
        return 1
    except KeyboardInterrupt:
        say("interrupted: finished shards are kept; the same command goes on from there")
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())

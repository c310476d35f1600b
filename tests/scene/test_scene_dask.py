"""The blocks of a scene on a dask cluster of real processes on this machine, one of which dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import FeatregError
from featreg.results.registration import Registration
from featreg.runtime.executors import open_executor

pytest.importorskip("distributed", reason="needs dask: pip install 'featreg[dask]'")
pytestmark = pytest.mark.slow


@dataclass
class Cluster:
    """A scheduler and its workers."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "5",
    }
    with ExitStack() as stack:

        def start(*command: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                [sys.executable, "-m", "distributed.cli." + command[0], *command[1:]],
                cwd=tmp_path,
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        file = tmp_path / "scheduler.json"
        scheduler = start(
            "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)
        )
        address = _address(file)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(tmp_path))
        workers = [start("dask_worker", address, "--host", "127.0.0.1", *options) for _ in range(2)]
        yield Cluster(address, scheduler, workers)


def _address(file: Path) -> str:
    import json

    end = time.monotonic() + 60
    while time.monotonic() < end:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError, KeyError):
            time.sleep(0.1)
    pytest.fail("the dask scheduler did not start within a minute")


def equal(a: Registration, b: Registration) -> bool:
    assert a.model
    assert b.model
    return (
        np.array_equal(a.matches.secondary_xy, b.matches.secondary_xy)
        and np.array_equal(a.inliers, b.inliers)
        and repr(a.model.parameters) == repr(b.model.parameters)
    )


def test_a_cluster_that_loses_a_worker_gives_the_same_result(
    cluster: Cluster, located_pair: Any, tmp_path: Path
) -> None:
    from distributed import Client

    wanted = featreg.match(located_pair.reference, located_pair.secondary, block=150, workers=1)
    client: Any = Client(cluster.address, timeout=60)  # type: ignore[no-untyped-call]
    with client:
        client.wait_for_workers(2, timeout=60)
        killed: list[int] = []

        def kill_one(done: int, total: int) -> None:
            if done >= 4 and not killed:
                killed.append(done)
                os.kill(cluster.workers[0].pid, signal.SIGKILL)

        got = featreg.match(
            located_pair.reference, located_pair.secondary, block=150, executor=client, progress=kill_one
        )
        assert killed
        cluster.workers[0].wait(timeout=10)
    assert got.provenance["blocks"]["failed"] == 0
    assert equal(got, wanted)
    # The one that is left serves the command, too.
    out = tmp_path / "r.json"
    command = [sys.executable, "-m", "featreg", "match", str(located_pair.reference), str(located_pair.secondary)]
    command += ["--block", "150", "--scheduler", cluster.address, "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert equal(Registration.from_json(out), wanted)
    # Without its scheduler a run ends in one line.
    client = Client(cluster.address, timeout=60)  # type: ignore[no-untyped-call]
    with client, open_executor(client, None) as executor:
        running = executor.run(time.sleep, (), [0.01, *[30.0] * 3], None)
        next(running)
        cluster.scheduler.kill()
        with pytest.raises(FeatregError, match="connection to the dask scheduler was lost"):
            list(running)

"""What a dask cluster costs beside the blocks themselves, what a run says when parts of it die, and how it scales.

    python benchmarks/cluster.py OUT [--size 10000x11000] [--workers 2] [--side 40000] [--block PX] [--harm]

Makes the pair once (`wide_pair.py`, kept in OUT), measures on this machine how long its blocks take, what goes to a
worker and comes back, and what scheduler and client take for a task and a block; then runs `featreg match` on a cluster
of that many workers of one thread, beside as many processes without dask. With `--harm` also kills a worker, lets
workers run out of memory and kills the scheduler, and prints how the command ends. From what was measured a simulation
tells the wall time of a scene of `--side` pixels on 1 to 1000 workers, and what bounds it.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import json
import os
import pickle
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scene import watched
from wide_pair import wide_pair

import featreg
from featreg.runtime.dask_tasks import AHEAD, bundle_size
from featreg.runtime.executors import InProcessExecutor

METHOD = "sar-orb"
#: Bytes read for each of the files, since halos are read twice.
TWICE = 1.3
WORKERS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
#: Seconds that a worker takes to import the package and load its kernels.
WORKER_START = 2.0
#: What a store of many workers gives, bytes a second, how often an hour each worker dies, and seconds until another one
#: stands in its place: of a spot machine in a bad hour.
STORE, DEATHS, REPLACED = 3e9, 10.0, 60.0


@dataclass(frozen=True)
class Costs:
    """What a run on a cluster is made of, seconds and bytes.

    `blocks` are measured times of single blocks; `start` and `end` what the client does alone, before the first block
    and, for each block, after the last; a bundle of n blocks takes the scheduler and the client their `bundle` and n
    times their `block`, and a worker `worker_start` once.
    """

    blocks: tuple[float, ...]
    start: float = 0.0
    end: float = 0.0
    client_bundle: float = 0.0
    client_block: float = 0.0
    scheduler_bundle: float = 0.0
    scheduler_block: float = 0.0
    worker_start: float = 0.0
    read: float = 0.0
    store: float = STORE
    deaths: float = 0.0
    replaced: float = REPLACED


@dataclass(frozen=True)
class Simulated:
    """Wall seconds, the shares of it for which scheduler, client, workers and store are busy, and blocks done again."""

    wall_s: float
    scheduler: float
    client: float
    workers: float
    store: float
    again: int


def simulate(costs: Costs, count: int, workers: int, seed: int = 0) -> Simulated:
    """One scene of `count` blocks on `workers` workers, event by event.

    Client and scheduler serve one bundle after the other, out and back; the store shares its rate among all workers; a
    worker that dies loses the bundle in hand, which is handed out again.
    """
    rng = np.random.default_rng(seed)
    drawn = rng.choice(np.array(costs.blocks), count)
    reading = costs.read * workers / costs.store
    mean, left = float(np.mean(costs.blocks)), deque(range(count))
    client_free = scheduler_free = costs.start
    client_busy, scheduler_busy, worked, again, out, done = costs.start, 0.0, 0.0, 0, 0, 0
    idle, fresh = deque(range(workers)), set(range(workers))
    waiting: deque[list[int]] = deque()
    dies = rng.exponential(3600 / costs.deaths, workers) if costs.deaths else np.full(workers, np.inf)
    events: list[tuple[float, int, str, Any]] = []
    numbers = itertools.count()

    def at(when: float, what: str, which: Any) -> None:
        heapq.heappush(events, (when, next(numbers), what, which))

    def by_client(n: int) -> None:
        nonlocal client_free, client_busy
        taken = (costs.client_bundle + n * costs.client_block) / 2
        client_free, client_busy = max(client_free, now) + taken, client_busy + taken

    def by_scheduler(since: float, n: int) -> float:
        nonlocal scheduler_free, scheduler_busy
        taken = (costs.scheduler_bundle + n * costs.scheduler_block) / 2
        scheduler_free, scheduler_busy = max(scheduler_free, since) + taken, scheduler_busy + taken
        return scheduler_free

    now = costs.start
    while done < count:
        while left and out < AHEAD * workers:
            bundle = [left.popleft() for _ in range(bundle_size(len(left), workers, mean))]
            out += 1
            by_client(len(bundle))
            at(by_scheduler(client_free, len(bundle)), "handed", bundle)
        while waiting and idle:
            bundle, worker = waiting.popleft(), idle.popleft()
            taken = float(drawn[bundle].sum()) + len(bundle) * reading
            taken += costs.worker_start if worker in fresh else 0.0
            fresh.discard(worker)
            if dies[worker] < now + taken:
                again += len(bundle)
                at(max(now, float(dies[worker])), "lost", (worker, bundle))
            else:
                worked += taken
                at(now + taken, "worked", (worker, bundle))
        now, _, what, which = heapq.heappop(events)
        if what == "handed":
            waiting.append(which)
        elif what == "worked":
            idle.append(which[0])
            at(by_scheduler(now, len(which[1])), "back", which[1])
        elif what == "lost":
            worker, bundle = which
            waiting.appendleft(bundle)
            dies[worker] = now + costs.replaced + rng.exponential(3600 / costs.deaths)
            at(now + costs.replaced, "replaced", worker)
        elif what == "replaced":
            fresh.add(which)
            idle.append(which)
        else:
            by_client(len(which))
            out, done = out - 1, done + len(which)
    now = client_free
    wall = now + count * costs.end
    return Simulated(
        wall, scheduler_busy / wall, (client_busy + count * costs.end) / wall, worked / (wall * workers),
        count * costs.read / costs.store / wall, again,
    )  # fmt: skip


class Recording(InProcessExecutor):
    """Runs each call here and records its seconds and the bytes of the call and of its result."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, int, int]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        start = time.perf_counter()
        future = super().submit(fn, *args, **kwargs)
        seconds = time.perf_counter() - start
        self.rows.append((seconds, len(pickle.dumps((fn, args))), len(pickle.dumps(future.result()))))
        return future


@dataclass
class Cluster:
    """A scheduler and workers of one thread on this machine."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def cluster(workers: int, *options: str) -> Iterator[Cluster]:
    """A cluster until the block ends; `options` are more of `dask worker`."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="featreg-cluster-")))

        def start(name: str, *given: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{name}", *given, "--host", "127.0.0.1", "--no-dashboard"],
                cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                start_new_session=True,
            )  # fmt: skip
            stack.callback(process.wait)
            # A nanny's worker with it.
            stack.callback(_ended, process)
            return process

        file = folder / "scheduler.json"
        scheduler = start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))
        while not file.exists():
            time.sleep(0.1)
        time.sleep(0.5)
        address = str(json.loads(file.read_text())["address"])
        given = ("--nthreads", "1", "--local-directory", str(folder), *(options or ("--no-nanny",)))
        made = [start("dask_worker", address, *given) for _ in range(workers)]
        client = client_of(address)
        client.wait_for_workers(workers, timeout=120)
        client.close()
        yield Cluster(address, scheduler, made)


def _ended(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def client_of(address: str) -> Any:
    """A client of dask, which has no types."""
    from distributed import Client

    make: Any = Client
    return make(address, timeout=60, set_as_default=False)


def processor_seconds(process: int) -> float:
    """User and system time of a living process (Linux)."""
    user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def overheads(running: Cluster, size: int, tasks: int = 150, bundle: int = 16) -> dict[str, float]:
    """Seconds that client and scheduler take for a bundle and for a block of it, whose results are `size` bytes.

    From blocks that do nothing, in tasks of one each and in bundles.
    """
    client = client_of(running.address)

    def taken(items: list[int], n: int) -> list[float]:
        processes = (running.scheduler.pid, os.getpid())
        before = [processor_seconds(p) for p in processes]
        future = [client.submit(_nothing, size, n, pure=False) for _ in items[:6]]
        waiting = deque(items[6:])
        while future:
            client.gather([future.pop(0)])
            if waiting:
                waiting.popleft()
                future.append(client.submit(_nothing, size, n, pure=False))
        return [(processor_seconds(p) - b) / len(items) for p, b in zip(processes, before, strict=True)]

    with client:
        taken([0] * 20, 1)
        one, many = taken([0] * tasks, 1), taken([0] * tasks, bundle)
    out: dict[str, float] = {}
    for name, single, several in zip(("scheduler", "client"), one, many, strict=True):
        block = max(0.0, (several - single) / (bundle - 1))
        out |= {f"{name}_block": block, f"{name}_bundle": max(0.0, single - block)}
    return out


def _nothing(size: int, count: int) -> list[bytes]:
    return [bytes(size)] * count


def measured_costs(place: Path, running: Cluster, block: list[str]) -> tuple[Costs, dict[str, Any]]:
    """The costs of a pair's blocks, and what is printed of them."""
    recording = Recording()
    images = str(place / "reference.tif"), str(place / "secondary.tif")
    side = int(block[1]) if block else None
    start = time.perf_counter()
    moments: list[float] = []
    featreg.match(
        *images, method=METHOD, block=side, executor=recording,
        progress=lambda done, total: moments.append(time.perf_counter()),
    )  # fmt: skip
    end = time.perf_counter()
    count = len(moments) - 1
    rows = recording.rows[-count:]
    seconds = [row[0] for row in rows]
    out, back = (statistics.mean(row[k] for row in rows) for k in (1, 2))
    taken = overheads(running, round(back))
    costs = Costs(
        tuple(seconds), start=moments[0] - start, end=(end - moments[-1]) / count, worker_start=WORKER_START,
        read=TWICE * sum(file.stat().st_size for file in place.glob("*.tif")) / count, **taken,
    )  # fmt: skip
    quantiles = np.percentile(seconds, [5, 50, 95])
    return costs, {
        "blocks": count,
        "ms a block (5, 50, 95 %)": [round(1e3 * q, 1) for q in quantiles],
        "kB out": round(out / 1e3, 1),
        "kB back": round(back / 1e3, 1),
        **{f"{name} ms": round(1e3 * value, 3) for name, value in taken.items()},
        "first s": round(costs.start, 2),
        "after the last, ms a block": round(1e3 * costs.end, 2),
    }


def on_cluster(
    place: Path, running: Cluster, block: list[str], after: Callable[[float, int], None] | None = None
) -> dict[str, Any]:
    """Run the command on a cluster; what it took there."""
    result = place / "cluster.json"
    processes = [running.scheduler.pid, *(w.pid for w in running.workers)]
    before = [processor_seconds(p) for p in processes]
    done = watched(
        ["match", str(place / "reference.tif"), str(place / "secondary.tif"), "--method", METHOD, *block,
         "--scheduler", running.address, "--json", str(result)], after=after,
    )  # fmt: skip
    row = {"exit code": done.code, **done.figures(), "said": done.said}
    if after is None:
        taken = [processor_seconds(p) - b for p, b in zip(processes, before, strict=True)]
        row |= {"scheduler s": round(taken[0], 2), "workers s": [round(t, 1) for t in taken[1:]]}
    return row


def harmed(place: Path, block: list[str], workers: int) -> Iterator[dict[str, Any]]:
    """How the command ends when parts of a cluster die while it runs."""

    def once(act: Callable[[], None], seconds: float) -> Callable[[float, int], None]:
        acted: list[float] = []

        def after(now: float, _: int) -> None:
            if now >= seconds and not acted:
                acted.append(now)
                act()

        return after

    with cluster(workers) as running:
        kill = once(running.workers[0].kill, 4.0)
        yield {"harm": "a worker killed", **on_cluster(place, running, block, kill)}
    with cluster(workers) as running:
        yield {"harm": "the scheduler killed", **on_cluster(place, running, block, once(running.scheduler.kill, 4.0))}
    with cluster(workers, "--memory-limit", "180MiB") as running:
        never = once(lambda: None, 0.0)
        yield {"harm": "180 MiB a worker", **on_cluster(place, running, block, never)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", default="10000x11000")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--side", type=int, default=40000)
    parser.add_argument("--block", type=int, help="side of a block; without, what suits the scene")
    parser.add_argument("--harm", action="store_true")
    given = parser.parse_args()
    rows, cols = (int(n) for n in given.size.split("x"))
    place = wide_pair(given.out, (rows, cols))
    block = [] if given.block is None else ["--block", str(given.block)]

    def tell(row: dict[str, Any]) -> None:
        print(json.dumps(row), flush=True)

    with cluster(given.workers) as running:
        costs, row = measured_costs(place, running, block)
        tell(row)
        for name in ("cold", "warm"):
            tell({"run": f"dask, {given.workers} workers, {name}", **on_cluster(place, running, block)})
    forked = ["--method", METHOD, *block, "--workers", str(given.workers), "--json", str(place / "forked.json")]
    done = watched(["match", str(place / "reference.tif"), str(place / "secondary.tif"), *forked])
    tell({"run": f"processes, {given.workers} workers", **done.figures()})
    tell({"run": "dask, simulated", **rounded(simulate(costs, len(costs.blocks), given.workers))})
    for row in harmed(place, block, given.workers) if given.harm else ():
        tell(row)
    count = round(len(costs.blocks) * given.side**2 / (rows * cols))
    for workers in WORKERS:
        plain, dying = (simulate(replace(costs, deaths=rate), count, workers) for rate in (0.0, DEATHS))
        worse = {"wall s with deaths": round(dying.wall_s, 1), "done again": dying.again}
        tell({"side": given.side, "blocks": count, "workers": workers, **rounded(plain), **worse})


def rounded(done: Simulated) -> dict[str, Any]:
    """What is printed of a simulated run."""
    busy = {name: round(getattr(done, name), 2) for name in ("scheduler", "client", "workers", "store")}
    return {"wall s": round(done.wall_s, 1), "busy": busy}


if __name__ == "__main__":
    main()

"""Tasks on a dask cluster in bundles: their sizes, and what a lost cluster says. The client is a stand-in."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from typing import Any

import pytest

from featreg.errors import FeatregError
from featreg.runtime import dask_tasks
from featreg.runtime.dask_tasks import LARGEST, DaskTasks, bundle_size


class Client:
    """Runs a call when it is submitted; counts bundles, and the futures that are asked for together."""

    def __init__(self, threads: int = 2) -> None:
        self.threads, self.bundles, self.waiting, self.most = threads, list[int](), 0, 0

    def nthreads(self) -> dict[str, int]:
        return {"one": self.threads} if self.threads else {}

    def submit(self, run: Callable[..., Any], *call: Any, pure: bool, retries: int) -> Any:
        assert not pure
        assert retries > 0
        self.bundles.append(len(call[-1]))
        self.waiting += 1
        self.most = max(self.most, self.waiting)
        future: concurrent.futures.Future[Any] = concurrent.futures.Future()
        try:
            future.set_result(run(*call))
        except Exception as error:
            future.set_exception(error)
        return future

    def gather(self, futures: list[Any]) -> list[Any]:
        self.waiting -= len(futures)
        return [future.result() for future in futures]


def _sum(first: int, second: int) -> int:
    return first + second


def test_every_item_is_done_once_in_bundles_that_grow_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_tasks, "SERVED", 0.0)
    client = Client(threads=2)
    got = dict(DaskTasks(client).run(_sum, (10,), range(400), None))
    assert got == {k: 10 + k for k in range(400)}
    # Until the first come back nothing is known of how long one takes.
    assert client.bundles[:6] == [1] * 6
    assert max(client.bundles) == LARGEST
    assert client.bundles[-4:] == [1] * 4
    assert client.most <= dask_tasks.AHEAD * 2
    assert list(DaskTasks(client).run(_sum, (10,), [], None)) == []


def test_a_bundle_is_no_longer_than_a_second_nor_than_its_share() -> None:
    assert bundle_size(4000, 2, 0.05) == LARGEST
    assert bundle_size(4000, 2, 0.3) == 3
    assert bundle_size(4000, 2, 20.0) == 1
    assert bundle_size(4000, 40, 0.05) == LARGEST
    assert bundle_size(2000, 40, 0.05) == 12
    assert bundle_size(0, 2, 0.05) == 0


def test_many_workers_get_bundles_that_the_scheduler_can_serve() -> None:
    # 250 bundles a second keep 100 workers busy for .05 s a block where 8 are in each.
    assert bundle_size(3000, 100, 0.05) == 8
    # Of few blocks, as many as are done while the scheduler hands out the others.
    assert bundle_size(200, 1000, 0.05) == 4
    assert bundle_size(3, 200, 0.05) == 1
    assert bundle_size(200, 1000, 20.0) == 1


def test_workers_that_come_later_get_their_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_tasks, "ASKED_EVERY", 0.0)
    client = Client(threads=1)
    running = DaskTasks(client).run(_sum, (0,), range(300), None)
    next(running)
    client.threads = 8
    assert len(list(running)) == 299
    assert dask_tasks.AHEAD < client.most <= dask_tasks.AHEAD * 8


def test_a_cluster_without_workers_is_waited_for_and_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_tasks, "ASKED_EVERY", 0.0)
    client = Client(threads=0)
    assert dict(DaskTasks(client).run(_sum, (0,), [5], None)) == {0: 5}
    monkeypatch.setattr(dask_tasks, "FORSAKEN", -1.0)
    with pytest.raises(FeatregError, match="has had no workers"):
        list(DaskTasks(client).run(_sum, (0,), [5], None))


def test_workers_that_left_between_two_runs_are_waited_for_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("featreg.runtime.dask_tasks.time.monotonic", lambda: now[0])
    client = Client()
    tasks = DaskTasks(client)
    assert dict(tasks.run(_sum, (0,), [5], None)) == {0: 5}
    now[0], client.threads = 10 * dask_tasks.FORSAKEN, 0
    assert dict(tasks.run(_sum, (0,), [5], None)) == {0: 5}


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (concurrent.futures.CancelledError("lost"), "connection to the dask scheduler was lost"),
        (type("CommClosedError", (OSError,), {"__module__": "distributed.comm.core"})(), "connection to the dask"),
        (
            type("KilledWorker", (Exception,), {"__module__": "distributed.scheduler"})(),
            "one worker .* after the other",
        ),
    ],
)
def test_a_lost_cluster_is_one_line(raised: Exception, said: str) -> None:
    class Lost(Client):
        def gather(self, futures: list[Any]) -> list[Any]:
            raise raised

    with pytest.raises(FeatregError, match=said) as error:
        list(DaskTasks(Lost()).run(_sum, (0,), [5], None))
    assert "\n" not in str(error.value)


def test_what_a_task_raises_passes_through() -> None:
    with pytest.raises(ZeroDivisionError):
        list(DaskTasks(Client()).run(divmod, (1,), [0], None))

"""The dask cluster of a scheduler's address."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from featreg.errors import InputError, ParameterError

#: Seconds to wait for a dask scheduler.
PATIENCE = 10


@contextmanager
def dask_client(address: str | None, executor: Any = None) -> Iterator[Any]:
    """A dask client of the scheduler at an address, closed at the end; `executor` where no address is given.

    Raises
    ------
    ParameterError
        Both are given, or dask is not installed.
    InputError
        No scheduler answers there, or it has no workers.
    """
    if address is None:
        yield executor
        return
    if executor is not None:
        raise ParameterError("scheduler and executor both say what runs the blocks: leave one of them out")
    try:
        from distributed import Client
    except ImportError as error:
        raise ParameterError("a scheduler needs dask: pip install 'featreg[dask]'") from error
    try:
        client: Any = Client(address, timeout=PATIENCE, set_as_default=False)  # type: ignore[no-untyped-call]  # distributed has no types
    except (OSError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())[:160]
        raise InputError(f"scheduler '{address}': no dask scheduler answers there ({why})") from error
    with client:
        if not client.nthreads():
            raise InputError(f"scheduler '{address}': has no workers yet; start some with 'dask worker {address}'")
        yield client

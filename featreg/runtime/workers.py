"""What a worker process of ours does before its first task, and whether one may be forked."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from multiprocessing.connection import wait

from featreg.runtime.threads import end_helpers, limit_algebra, use_one_thread


def start_worker(keep_memory: bool = False) -> None:
    """Leave Ctrl-C to the parent, end with it, and use one thread.

    Parameters
    ----------
    keep_memory : see `keep_freed_memory`
    """
    # Ctrl-C reaches every process of the terminal; the parent alone reacts.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="featreg-parent-watch", daemon=True).start()
    if keep_memory:
        keep_freed_memory()
    # Inherited through a fork, the variables are late for the libraries, but not for those still to be imported.
    limit_algebra(1)
    use_one_thread()


def _end_with_parent() -> None:
    """End this process when its parent is gone, however it went: a hanging task must not outlive it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        time.sleep(0.1)
        os._exit(1)


def can_fork() -> bool:
    """Whether this process may be forked: on Linux, and while it has one thread, those of libraries included.

    A fork copies one thread only; a lock that another one held would stay locked for ever. Those that wait for work of
    ours are ended first.
    """
    end_helpers()
    if sys.platform != "linux":
        return False
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


def keep_freed_memory() -> None:
    """Let this process keep the memory that a block gives back for the next one; a process of ours only.

    The C library of Linux returns large arrays to the system at once, and the faults of their pages, taken anew for
    each block, cost a sixth of its time (measured). Elsewhere nothing happens.
    """
    if sys.platform != "linux":
        return
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    mmap_threshold, trim_threshold = -3, -1
    mallopt(mmap_threshold, 32 << 20)
    mallopt(trim_threshold, 256 << 20)

"""Workers end with their work: what is queued, shut down, or left by its parent."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from featreg.runtime.isolation import IsolatedExecutor, WorkerLostError


def test_what_is_queued_is_finished_when_the_executor_is_left(rogues: Any) -> None:
    with IsolatedExecutor(1) as executor:
        futures = [executor.submit(abs, -k) for k in range(3)]
        pid = executor.submit(rogues.threads).result()[2]
    assert [future.result() for future in futures] == [0, 1, 2]
    assert not alive(pid)


def test_shutting_down_ends_what_runs_and_drops_what_waits(rogues: Any) -> None:
    executor = IsolatedExecutor(1)
    pid = executor.submit(rogues.threads).result()[2]
    running, waiting = executor.submit(rogues.sleep, 600), executor.submit(rogues.sleep, 600)
    while not running.running():
        time.sleep(0.01)
    executor.shutdown(cancel_futures=True)
    assert waiting.cancelled()
    assert isinstance(running.exception(), WorkerLostError)
    assert not alive(pid)
    with pytest.raises(RuntimeError, match="shutdown"):
        executor.submit(abs, 1)


@pytest.mark.slow
def test_workers_die_with_their_parent(rogues: Any, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(Path(rogues.__file__).parent)!r})\n"
        "import rogues\n"
        "from featreg.runtime.isolation import IsolatedExecutor\n"
        "if __name__ == '__main__':\n"
        "    executor = IsolatedExecutor(1)\n"
        "    print(executor.submit(rogues.threads).result()[2], flush=True)\n"
        "    executor.submit(rogues.sleep, 600).result()\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 20
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(pid)


def alive(pid: int) -> bool:
    """Whether a process runs; one that ended and was not waited for does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"

"""A bar of progress wherever one looks at it: in a notebook by tqdm where that is installed, in a terminal by rich."""

from __future__ import annotations

import sys
from typing import Any

from featreg.runtime.watching import Progress

#: Bars that are being drawn.
_open: set[Any] = set()


class ProgressBar:
    """A callback of (done, in all) that draws a bar, made at the first call and taken away at the last.

    Parameters
    ----------
    text : stands before the bar
    """

    def __init__(self, text: str) -> None:
        self._text, self._bar, self._done = text, None, 0

    def __call__(self, done: int, total: int) -> None:
        if self._bar is None:
            self._bar, self._done = _made(self._text, total), 0
            _open.add(self)
        self._bar.advance(done - self._done)
        self._done = done
        if done >= total:
            self.close()

    def close(self) -> None:
        """Leave the bar as it stands, on a line of its own."""
        bar, self._bar = self._bar, None
        _open.discard(self)
        if bar is not None:
            bar.close()

    _bar: Any


def close_bars() -> None:
    """Leave every bar as it stands, as where the work ended early."""
    for bar in list(_open):
        bar.close()


def progress_bar(text: str = "") -> Progress:
    """Return a callback for every `progress=` of featreg: a bar in a notebook or terminal, silence in a pipe.

    Parameters
    ----------
    text : stands before the bar
    """
    return ProgressBar(text)


def in_notebook() -> bool:
    """Whether this runs in a kernel that shows more than text; nothing is imported to find out."""
    shell = sys.modules.get("IPython")
    made = shell.get_ipython() if shell is not None and hasattr(shell, "get_ipython") else None
    return made is not None and getattr(made, "kernel", None) is not None


class _Silent:
    def advance(self, steps: int) -> None:
        pass

    def close(self) -> None:
        pass


class _Tqdm:
    def __init__(self, text: str, total: int) -> None:
        from tqdm.auto import tqdm

        self._bar = tqdm(total=total, desc=text)

    def advance(self, steps: int) -> None:
        self._bar.update(steps)

    def close(self) -> None:
        self._bar.close()


class _Rich:
    def __init__(self, text: str, total: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        console = Console(stderr=True)
        # Without a thread and with the cursor as it was, work that ends early leaves the terminal as it found it.
        plain: Any = {"auto_refresh": False, "redirect_stdout": False, "redirect_stderr": False}
        self._bar = Progress(*columns, console=console, **plain)
        self._bar.start()
        console.show_cursor(True)
        self._task = self._bar.add_task(text, total=total)

    def advance(self, steps: int) -> None:
        self._bar.advance(self._task, steps)
        self._bar.refresh()

    def close(self) -> None:
        self._bar.stop()


def _made(text: str, total: int) -> Any:
    if in_notebook():
        try:
            return _Tqdm(text, total)
        except ImportError:
            return _Silent()
    return _Rich(text, total) if sys.stderr.isatty() else _Silent()

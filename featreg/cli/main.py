"""The command line: `featreg match`, `explain`, `view`, `compare`, `sweep`, `warp`, `export`, `mark` and others.

Exit codes: 0 good; 1 an error of this program; 2 usage or bad input; 3 no trustworthy result (what was asked for is
still written); 4 a comparison with failed rows; 130 interrupted. Whatever goes wrong is one line on stderr.
"""

from __future__ import annotations

import gc
import importlib
import logging
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import wraps
from typing import Annotated, Any

import typer

from featreg._version import __version__
from featreg.cli.completion import asked_words
from featreg.errors import FeatregError, UnknownNameError, suggest
from featreg.runtime.environment import TRACEBACK, check_environment
from featreg.runtime.progress import close_bars

#: Name -> module in `featreg.cli`, function, its first sentence. Only the one that is asked for is imported.
COMMANDS: dict[str, tuple[str, str, str]] = {
    "match": ("match", "match", "Register one SAR image to another."),
    "explain": ("explain", "explain", "Say why a result is trusted or not, and what to try."),
    "view": ("view", "view", "Look at a result in a browser."),
    "compare": ("compare", "compare", "Print a table of methods on image pairs."),
    "sweep": ("sweep", "sweep", "Print a table of one method over a grid of parameters."),
    "warp": ("warp", "warp", "Resample the secondary onto the reference."),
    "offsets": ("offsets", "offsets", "Measure how far each cell of a grid moved between two images."),
    "stack": ("stack", "stack", "Register many images of one place to one grid."),
    "info": ("info", "info", "Say what a file is and what featreg will do with it."),
    "export": ("export", "export", "Write the tie points for another program."),
    "focus": ("focus", "focus", "Focus a complex SAR image by autofocus."),
    "mark": ("mark", "mark", "Mark homologous points of two images in a local web page."),
    "list": ("listing", "list_names", "List methods and parts, or show what one of them takes."),
    "simulate": ("simulate", "simulate", "Simulate SAR images with exactly known truth."),
    "demo": ("demo", "demo", "Try everything on a simulated pair."),
    "doctor": ("doctor", "doctor", "Show what this installation is made of."),
}
#: New objects after which a command looks for circles of garbage among them: more than it imports. None holds an image.
MOST_YOUNG = 100_000
HELP = "Register SAR images: tie points, a geometric model and a verdict on whether to trust it."


def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"featreg {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


root.__doc__ = HELP


def application(arguments: Sequence[str]) -> typer.Typer:
    """The command line as far as these arguments need it: the one command that they name, or a list of all."""
    app = typer.Typer(
        help=HELP,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback(invoke_without_command=True)(root)
    named = _command(arguments)
    if named in COMMANDS:
        module, function, _ = COMMANDS[named]
        app.command(named)(_interruptible(getattr(importlib.import_module(f"featreg.cli.{module}"), function)))
    else:
        for name, (_, _, sentence) in COMMANDS.items():
            app.command(name, help=sentence)(_not_called)
    return app


def _not_called() -> None:
    """Stand for a command where all are listed and none is run."""


class _StoppedError(Exception):
    """Ctrl-C during a command, with the notes that the command left."""


def _interruptible(command: Callable[..., None]) -> Callable[..., None]:
    """The same command, whose interruption passes through the library that parses the command line as it is."""

    @wraps(command)
    def run(*arguments: Any, **options: Any) -> None:
        try:
            command(*arguments, **options)
        except KeyboardInterrupt as stop:
            raise _StoppedError(*getattr(stop, "__notes__", ())) from None

    return run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; `arguments` defaults to those of the process."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    own = arguments is None
    if "numpy" not in sys.modules:
        # Its small products gain nothing from more threads, which wait for one another at the cost of half a second;
        # what --threads and --workers ask for is shared out by this package itself.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if own:
        # The library behind the options would read the metadata of every installed package to look for plugins.
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
        # What is imported stays: looking through it for circles of garbage takes longer than reading an image.
        gc.set_threshold(MOST_YOUNG, *gc.get_threshold()[1:])
    out, err = (_Output(stream) for stream in (sys.stdout, sys.stderr))
    with redirect_stdout(out), redirect_stderr(err):
        code = _run(given)
        out.flush()
        if out.failed is not None and code in (0, 3):
            typer.echo(f"error: the standard output cannot be written ({out.failed.strerror})", err=True)
            code = 2
    if own:
        # The process ends: nothing is left to look through.
        gc.freeze()
    return code


def _run(given: Sequence[str]) -> int:
    notes = _Notes()
    logger = logging.getLogger("featreg")
    logger.addHandler(notes)
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:
                warnings.simplefilter("ignore")
            _check_command(given)
            # A shell that asks what could follow gives the words on its line, and no arguments.
            words = asked_words()
            if words is None:
                check_environment()
            try:
                code = application(given if words is None else words)(
                    args=given, prog_name="featreg", standalone_mode=False
                )
            finally:
                close_bars()
    except (KeyboardInterrupt, _StoppedError) as stop:
        return _interrupted(stop)
    except SystemExit as stop:
        # The library that parses the command line takes every broken pipe for that of its output.
        if isinstance(stop.__context__, BrokenPipeError):
            return _explain(stop.__context__, given)
        code = stop.code
    except Exception as error:
        return _explain(error, given)
    finally:
        logger.removeHandler(notes)
    for line in dict.fromkeys(notes.lines):
        typer.echo(f"warning: {line}", err=True)
    if code == 130:
        return _interrupted(KeyboardInterrupt())
    return code if isinstance(code, int) else 0


def _command(arguments: Sequence[str]) -> str | None:
    """The command: the first word, since the options before it take no values."""
    return next((a for a in arguments if not a.startswith("-")), None)


def _check_command(arguments: Sequence[str]) -> None:
    word = _command(arguments)
    if word is not None and word not in COMMANDS:
        raise UnknownNameError(f"unknown command '{word}', {suggest(word, COMMANDS)}")


def _explain(error: Exception, arguments: Sequence[str]) -> int:
    """Print one line about an error and return the exit code."""
    if isinstance(error, typer.Abort):
        return _interrupted(error)
    if isinstance(error, FeatregError):
        code, text = 2, str(error)
    elif isinstance(error, MemoryError) or type(error).__name__ == "_ArrayMemoryError":
        code, text = 2, "there is too little memory for this; work in smaller blocks (--block) or with fewer --workers"
    elif hasattr(error, "format_message"):  # of the library that parses the command line, whichever it builds upon
        code, text = 2, _usage(error, arguments)
    elif (text := _of_proj(error)) != "":
        code = 2
    else:
        code, text = 1, f"internal error: {type(error).__name__}: {error}"
        if os.environ.get(TRACEBACK) == "1":
            import traceback

            traceback.print_exception(error)
        else:
            text += ", set FEATREG_TRACEBACK=1 to see where"
    typer.echo(f"error: {' '.join(text.split())}", err=True)
    return code


def _interrupted(stop: BaseException) -> int:
    """Say that the work was stopped by hand, with what the command adds to that, and return the exit code."""
    # The terminal has shown ^C where its cursor was.
    start = "\n" if sys.stderr.isatty() else ""
    typer.echo(start + "; ".join(["interrupted", *map(str, stop.args)]), err=True)
    return 130


def _of_proj(error: Exception) -> str:
    """What is wrong with PROJ's data where an error comes of that, else an empty text."""
    if type(error).__module__.partition(".")[0] == "rasterio":
        from featreg.geolocation.projection import check_proj

        try:
            check_proj()
        except FeatregError as known:
            return str(known)
    return ""


def _usage(error: Any, arguments: Sequence[str]) -> str:
    """One line for a misspelt option, a missing argument or a value of the wrong kind."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context else " ".join(["featreg", *(a for a in arguments[:1] if a in COMMANDS)])
    name = getattr(error, "option_name", None)
    if name and context and type(error).__name__ == "NoSuchOption":
        known = [o for parameter in context.command.params for o in (*parameter.opts, *parameter.secondary_opts)]
        options = [o for o in (*known, "--help") if o.startswith("-")]
        return f"unknown option '{name}' of '{path}', {suggest(name, options)}"
    text = str(error.format_message()).strip().rstrip(".")
    return f"{text[:1].lower()}{text[1:]}; see '{path} --help'"


class _Output:
    """A stream whose reader may leave (`| head`): the command works on, and its exit code tells of that work.

    The same where there is no stream, where its disk is full (`failed`), or where its encoding lacks a character, which
    is then escaped.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = open(os.devnull, "w") if stream is None else stream  # noqa: SIM115
        self.failed: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return int(self._stream.write(text))
        except UnicodeEncodeError:
            encoding = getattr(self._stream, "encoding", None) or "ascii"
            return self.write(text.encode(encoding, "backslashreplace").decode(encoding))
        except BrokenPipeError:
            self._leave()
        except OSError as error:
            self._fail(error)
        return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._leave()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failed = self.failed or error
        self._leave()

    def _leave(self) -> None:
        """Send what is written from now on, and what is still held back, nowhere."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


class _Notes(logging.Handler):
    """Keeps warnings until the end, so that an error stays one line; hidden plugins are for `list` and `doctor`."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "featreg.registry":
            self.lines.append(" ".join(record.getMessage().split()))

"""The variables of the environment that are this package's own: what they may be, and an error where they are not."""

from __future__ import annotations

import logging
import os

from featreg.errors import InputError

logger = logging.getLogger(__name__)

KERNELS, TRACEBACK = "FEATREG_KERNELS", "FEATREG_TRACEBACK"
#: Variable -> its values -> what each asks for; unset or empty it asks for nothing.
VALUES = {
    KERNELS: {
        "numba": "numba compiles every kernel",
        "bitcode": "machine code is made here, not taken from where the package was built",
    },
    TRACEBACK: {"0": "one line about an error", "1": "also where an internal error arose"},
}
#: Those that tests, benchmarks, the documentation and plugins of other programs read.
OTHERS = ("FEATREG_DATA", "FEATREG_NOTEBOOKS", "FEATREG_AXE", "FEATREG_PROGRAM")


def setting(name: str) -> str:
    """The value of a variable of `VALUES`; "" where it is not set.

    Raises
    ------
    InputError
        It has a value that means nothing.
    """
    value = os.environ.get(name, "")
    if value and value not in VALUES[name]:
        known = " or ".join(f"'{known}' ({meaning})" for known, meaning in VALUES[name].items())
        raise InputError(f"the environment variable {name} is '{value}', give {known}, or leave it unset")
    return value


def check_environment() -> None:
    """Refuse values that mean nothing, and warn of variables whose names are nearly those of ours."""
    for name in VALUES:
        setting(name)
    for name in sorted(os.environ):
        if name.startswith("FEATREG_") and name not in VALUES and name not in OTHERS:
            import difflib

            if near := difflib.get_close_matches(name, (*VALUES, *OTHERS), n=1, cutoff=0.85):
                logger.warning("the environment variable %s is read by nothing, did you mean %s?", name, near[0])

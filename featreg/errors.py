"""Every error that featreg raises on purpose.

    FeatregError
    ├── InputError              a file, an array, a mask or a truth that cannot be used as it is
    │   ├── NoOverlapError           two images that do not see the same ground
    │   └── NoModelError             something asked of a model that could not be fitted
    ├── ParameterError          a parameter that does not exist, is ambiguous or has an impossible value
    ├── UnknownNameError        no plugin or preset of that name
    ├── PluginError             a plugin that breaks the rules of the registry
    │   ├── DuplicatePluginError     two plugins of one name
    │   └── PluginUnavailableError   a known plugin whose library cannot be imported here
    └── CancelledError          the caller's `cancel` event was set

A result that could not be found is not an error: it is an empty array, a falsy `FailedFit` or a `Registration`
whose status is "unreliable".
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FeatregError(Exception):
    """Base of all errors of this package; its text is one line fit for a user."""


class InputError(FeatregError, ValueError):
    """A file, array, mask or truth cannot be used as given."""


class NoOverlapError(InputError):
    """Two images do not see the same ground; the text says where each lies."""


class NoModelError(InputError, AttributeError):
    """Something was asked of a model that could not be fitted, or that its kind does not have; the text says why."""


class ParameterError(FeatregError, ValueError):
    """A parameter does not exist, is ambiguous or has an impossible value."""


class UnknownNameError(FeatregError, LookupError):
    """No plugin or preset has the given name."""


class PluginError(FeatregError):
    """A plugin breaks the rules of the registry (two of one name, parameters that cannot be listed)."""


class DuplicatePluginError(PluginError):
    """Two plugins have one name; the text names both modules."""


class PluginUnavailableError(PluginError, ImportError):
    """A known plugin cannot be used here; the text names the reason and the cure."""


class CancelledError(FeatregError):
    """The caller asked for the work to stop."""


def suggest(given: str, known: Iterable[str]) -> str:
    """Return the half sentence that follows "unknown X 'given'": the nearest names, or all when none is near."""
    names = sorted(known)
    near = difflib.get_close_matches(given, names, n=3, cutoff=0.5)
    if near:
        return "did you mean " + " or ".join(f"'{n}'" for n in near) + "?"
    return "known: " + ", ".join(names) if names else "none is registered"

"""Optional libraries, each imported in one place with the cure where it is missing."""

from __future__ import annotations

import importlib
from typing import Any

from featreg.errors import PluginUnavailableError

PANDAS_CURE = "pip install 'featreg[pandas]'"
TORCH_CURE = "pip install 'featreg[torch]'"


def import_pandas() -> Any:
    """Return the module `pandas`.

    Raises
    ------
    PluginUnavailableError
        It cannot be imported.
    """
    return _imported("pandas", "a DataFrame needs pandas", PANDAS_CURE)


def import_torch() -> Any:
    """Return the module `torch`.

    Raises
    ------
    PluginUnavailableError
        It cannot be imported.
    """
    return _imported("torch", "torch cannot be imported", TORCH_CURE)


def _imported(name: str, wanted: str, cure: str) -> Any:
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        raise PluginUnavailableError(f"{wanted} ({error}); {cure}") from error

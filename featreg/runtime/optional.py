"""Optional libraries, each imported in one place with the cure where it is missing."""

from __future__ import annotations

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
    try:
        import pandas
    except (ImportError, OSError) as error:
        raise PluginUnavailableError(f"a DataFrame needs pandas ({error}); {PANDAS_CURE}") from error
    return pandas


def import_torch() -> Any:
    """Return the module `torch`.

    Raises
    ------
    PluginUnavailableError
        It cannot be imported.
    """
    try:
        import torch
    except (ImportError, OSError) as error:
        raise PluginUnavailableError(f"torch cannot be imported ({error}); {TORCH_CURE}") from error
    return torch

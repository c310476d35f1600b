"""Optional libraries, each imported in one place with the cure where it is missing."""

from __future__ import annotations

from typing import Any

from featreg.errors import PluginUnavailableError

TORCH_CURE = "pip install 'featreg[torch]'"


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

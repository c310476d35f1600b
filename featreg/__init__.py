"""featreg: SAR image features, matching and registration, every method a plugin behind one interface."""

from featreg._version import __version__

__all__ = ["__version__"]

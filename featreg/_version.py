"""The version of the package: a constant, so that it is the same with and without a git checkout."""

__version__ = "0.1.0"

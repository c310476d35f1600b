"""Conformance of a plugin: what ours are held to, for the tests of somebody else's package."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from featreg import registry
from featreg.errors import PluginError, UnknownNameError, suggest
from featreg.testing.checks import EVERY, OF_KIND, SYMMETRY, Plugin

__all__ = ["check_plugin"]


def check_plugin(
    kind: str, name: str, *, symmetric: bool = True, leave_out: Collection[str] = (), **parameters: Any
) -> tuple[str, ...]:
    """Hold a registered plugin to what featreg's own are held to, on simulated images.

    Parameters
    ----------
    kind : "detector", "descriptor", "nearest", "filter" or "matcher"
    name : under which it is registered
    symmetric : False leaves out that mirrored and shifted images have mirrored and shifted points, which networks with
        trained weights cannot promise
    leave_out : names of other checks that it is known not to pass
    parameters : with which it is made

    Returns
    -------
    The names of the checks, all of which it passed

    Raises
    ------
    PluginError
        It fails; the text names every check that it failed, and how.
    UnknownNameError, PluginUnavailableError, ParameterError
        There is no such plugin or check, the plugin cannot be used here, or not with these parameters.

    Examples
    --------
    >>> check_plugin("filter", "fsc")[0]
    'parameters'
    """
    if kind not in OF_KIND:
        raise UnknownNameError(f"no plugins of kind '{kind}' can be checked, {suggest(kind, OF_KIND)}")
    checks = {**EVERY, **OF_KIND[kind]}
    for key in leave_out:
        if key not in checks:
            raise UnknownNameError(f"there is no check '{key}' of a {kind}, {suggest(key, checks)}")
    entry = registry.entry(kind, name)

    def make(**more: Any) -> Any:
        return registry.create(kind, name, **{**parameters, **more})  # type: ignore[call-overload]  # kind is one of OF_KIND

    plugin = Plugin(entry, make, make())
    left_out = {*leave_out, *(() if symmetric else SYMMETRY)}
    checks = {key: check for key, check in checks.items() if key not in left_out}
    failed = []
    for key, check in checks.items():
        try:
            failed += [f"{key}: {complaint}" for complaint in check(plugin)]
        except Exception as error:
            failed.append(f"{key}: it raised {type(error).__name__}: {error}")
    if failed:
        raise PluginError(f"{kind} '{name}' fails {len(failed)} checks: " + "; ".join(failed))
    return tuple(checks)

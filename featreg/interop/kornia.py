"""The one place that knows what kornia needs: its version, its networks, and how its parts are listed.

A plugin of kornia is a row of the table in its room: `KorniaRow` says how it is built and where its weights come from,
`KorniaMember` is what every plugin made from a row has.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from annotated_types import Ge

from featreg.errors import ParameterError, PluginUnavailableError
from featreg.interop.family import NORMALISE, Member, Row, option
from featreg.interop.weights import AUTO, LEARNED_CURE, PACKAGED, cached, load_weights, packaged, stamp
from featreg.runtime.optional import TORCH_CURE, import_torch

# Every plugin asks, and a distribution's metadata takes a millisecond to read.
version = cache(metadata.version)
# Before it, positions, frames and scores of several parts are others than what the tables here rely on.
NEEDED = (0, 9)
HOST = ("huggingface.co", 443)
PATIENCE = 3.0

#: What every part, and every network, is given beside its own parameters.
RUN = {
    "device": option("cpu", meaning="where networks run: 'cpu', 'cuda', 'cuda:1', 'mps' or 'auto'"),
    "threads": option(1, Ge(0), meaning="of the processor; 0 leaves it to torch"),
}
COMMON = {**NORMALISE, **RUN}
# What changes how a network is run, not what it is.
RUN_ONLY = ("n_features", "normalise", "threads", "tile", "batch", "describe", "support")


def plain(creator: str, values: Mapping[str, Any]) -> Any:
    """Return what kornia has under a name, as it is."""
    return getattr(import_kornia(), creator)


@dataclass(frozen=True)
class KorniaRow(Row):
    """One algorithm of kornia.

    Parameters
    ----------
    build : (kornia's name, parameters) -> what kornia offers for it; with ``trained=True`` that with the weights that
        kornia downloads
    files : parameters -> names under which kornia keeps the weights it downloads; None: it needs none
    source : where these weights come from
    pixel_bytes : memory that it takes for each pixel that it looks at, as measured; 0 where it is little
    """

    build: Callable[..., Any] = plain
    files: Callable[[Mapping[str, Any]], tuple[str, ...]] | None = None
    source: str = ""
    pixel_bytes: float = 0.0

    @property
    def unavailable(self) -> str:
        missing = library_missing()
        if missing or self.files is None:
            return missing
        absent = self.absent(self.defaults)
        return _no_weights(self, absent) if absent else ""

    def absent(self, values: Mapping[str, Any]) -> list[str]:
        """Names of the weights that no package here ships and kornia has not downloaded."""
        return [name for name in self.files(values) if not packaged(name) and not cached(name)] if self.files else []

    def shipped(self, values: Mapping[str, Any]) -> list[Path]:
        """The files of weights in installed packages; empty where any of them is in none."""
        paths = [packaged(name) for name in self.files(values)] if self.files else []
        return [path for path in paths if path] if all(paths) else []

    @property
    def on_demand(self) -> bool:
        return self.files is not None and not library_missing()


def library_missing() -> str:
    """Return why kornia cannot be used here, with the cure, "" where it can; nothing is imported."""
    for name in ("torch", "kornia"):
        try:
            found = find_spec(name) is not None
        except (ImportError, ValueError):
            found = False
        if not found:
            return f"{name} is not installed; {TORCH_CURE}"
    try:
        installed = version("kornia")
    except metadata.PackageNotFoundError:
        return ""
    numbers = tuple(int(n) for n in installed.split(".")[:2] if n.isdigit())
    if numbers < NEEDED:
        return f"kornia {installed} is installed, {'.'.join(map(str, NEEDED))} or newer is needed; {TORCH_CURE}"
    return ""


def import_kornia() -> Any:
    """Return the module `kornia.feature`.

    Raises
    ------
    PluginUnavailableError
        It is not installed, too old, or broken.
    """
    missing = library_missing()
    if missing:
        raise PluginUnavailableError(missing)
    import_torch()
    try:
        import kornia.feature
    except (ImportError, OSError) as error:
        raise PluginUnavailableError(f"kornia cannot be imported ({error}); {TORCH_CURE}") from error
    return kornia.feature


class KorniaMember(Member):
    """What the plugins of kornia have in common: a network, built once for its parameters and shared."""

    table: ClassVar[Mapping[str, KorniaRow]]
    compiled = False

    def network(self) -> Any:
        """Return what kornia offers for these parameters, with its weights, on its device."""
        kept = {k: v for k, v in self.parameters.items() if k not in RUN_ONLY}
        stamps = tuple(stamp(kept[key]) for key in ("weights", "descriptor_weights") if given(kept.get(key)))
        owner: Any = type(self)
        return _network(owner, self.name, tuple(sorted(kept.items())), stamps)


def given(weights: str | None) -> bool:
    """Whether a parameter names a file of weights."""
    return weights is not None and weights != AUTO


@lru_cache(maxsize=8)
def _network(kind: type[KorniaMember], name: str, told: tuple[tuple[str, Any], ...], stamps: tuple[Any, ...]) -> Any:
    from featreg.interop.torch_arrays import as_device

    values, row = dict(told), kind.table[name]
    import_kornia()
    # A new network is filled with random numbers before its weights are read: the caller's stay as they were.
    with import_torch().random.fork_rng(devices=[]):
        made = row.build(row.creator, values) if row.files is None else _loaded(name, row, values)
    return made.to(as_device(values["device"])).eval() if hasattr(made, "eval") else made


def _loaded(name: str, row: KorniaRow, values: Mapping[str, Any]) -> Any:
    """The network of a row with the weights that were given, that a package ships, or that kornia downloads."""
    shipped = row.shipped(values)
    if given(values["weights"]) or shipped:
        network = row.build(row.creator, values)
        targets = {"weights": network}
        if "descriptor_weights" in values:
            if not given(values["descriptor_weights"]):
                raise ParameterError(f"{name} needs two files: weights=FILE and descriptor_weights=FILE")
            targets = {"weights": network.detector, "descriptor_weights": network.descriptor}
        for key, module in targets.items():
            load_weights(module, values[key] if given(values[key]) else str(shipped[0]))
        return network
    absent = row.absent(values)
    if absent and not reachable():
        raise PluginUnavailableError(f"{name}: {_no_weights(row, absent)} ({HOST[0]} cannot be reached now)")
    try:
        return row.build(row.creator, values, trained=True)
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        text = " ".join(str(error).split())[:200]
        raise PluginUnavailableError(f"{name}: {_no_weights(row, absent)} (kornia: {text})") from error


def _no_weights(row: KorniaRow, absent: list[str]) -> str:
    names = " and ".join(absent) or "the weights"
    ways = f"give weights=FILE ({names} from {row.source}) or go online"
    if absent and all(name in PACKAGED for name in absent):
        ways = f"{LEARNED_CURE} brings them; or {ways}"
    return f"its trained weights are not on this machine; {ways}"


def reachable() -> bool:
    """Whether the host of the weights, or the proxy that stands before it, answers within a few seconds."""
    from urllib.request import getproxies

    proxy = getproxies().get("https", "")
    address = HOST
    if proxy:
        from urllib.parse import urlsplit

        parts = urlsplit(proxy if "://" in proxy else f"http://{proxy}")
        address = (parts.hostname or HOST[0], parts.port or 80)
    answered = threading.Event()

    def knock() -> None:
        try:
            socket.create_connection(address, timeout=PATIENCE).close()
        except OSError:
            return
        answered.set()

    # Looking up the name has no time limit of its own.
    caller = threading.Thread(target=knock, daemon=True)
    caller.start()
    caller.join(PATIENCE)
    return answered.is_set()

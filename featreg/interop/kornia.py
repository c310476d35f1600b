"""The one place that knows what kornia needs: its version, the weights of its networks, and how its parts are listed.

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
from os import environ
from pathlib import Path
from typing import Any, ClassVar

from annotated_types import Ge

from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.interop.family import NORMALISE, Member, Row, option
from featreg.runtime.optional import TORCH_CURE, import_torch

# Every plugin asks, and a distribution's metadata takes a millisecond to read.
version = cache(metadata.version)
# Before it, positions, frames and scores of several parts are others than what the tables here rely on.
NEEDED = (0, 9)
HOST = ("huggingface.co", 443)
PATIENCE = 3.0
# Under these keys the authors' files hold the tensors.
WRAPPERS = ("state_dict", "extractor", "model", "net")

#: What every part, and every network, is given beside its own parameters.
RUN = {
    "device": option("cpu", meaning="where networks run: 'cpu', 'cuda', 'cuda:1', 'mps' or 'auto'"),
    "threads": option(1, Ge(0), meaning="of the processor; 0 leaves it to torch"),
}
COMMON = {**NORMALISE, **RUN}


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
    """

    build: Callable[..., Any] = plain
    files: Callable[[Mapping[str, Any]], tuple[str, ...]] | None = None
    source: str = ""

    @property
    def unavailable(self) -> str:
        missing = library_missing()
        if missing or self.files is None:
            return missing
        absent = [name for name in self.files(self.defaults) if not cached(name)]
        return _no_weights(self, absent) if absent else ""

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


def cached(name: str) -> bool:
    """Whether kornia has already downloaded the weights of this file name."""
    home = Path(environ.get("TORCH_HOME") or Path(environ.get("XDG_CACHE_HOME") or "~/.cache", "torch")).expanduser()
    return (home / "hub" / "checkpoints" / name).is_file()


class KorniaMember(Member):
    """What the plugins of kornia have in common: a network, built once for its parameters and shared."""

    table: ClassVar[Mapping[str, KorniaRow]]
    compiled = False

    def network(self) -> Any:
        """Return what kornia offers for these parameters, with its weights, on its device."""
        kept = {k: v for k, v in self.parameters.items() if k not in ("n_features", "normalise", "threads")}
        stamps = tuple(_stamp(kept[key]) for key in ("weights", "descriptor_weights") if kept.get(key))
        owner: Any = type(self)
        return _network(owner, self.name, tuple(sorted(kept.items())), stamps)


@lru_cache(maxsize=8)
def _network(kind: type[KorniaMember], name: str, given: tuple[tuple[str, Any], ...], stamps: tuple[Any, ...]) -> Any:
    from featreg.interop.torch_arrays import as_device

    values, row = dict(given), kind.table[name]
    import_kornia()
    # A new network is filled with random numbers before its weights are read: the caller's stay as they were.
    with import_torch().random.fork_rng(devices=[]):
        made = row.build(row.creator, values) if row.files is None else _loaded(name, row, values)
    return made.to(as_device(values["device"])).eval() if hasattr(made, "eval") else made


def _stamp(path: str) -> tuple[str, float, int]:
    """What tells whether a file of weights is still the same."""
    try:
        state = Path(path).stat()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(
            f"weights file {path}: {reason}; give a file saved with torch.save, or leave it out"
        ) from error
    return str(Path(path).resolve()), state.st_mtime, state.st_size


def _loaded(name: str, row: KorniaRow, values: Mapping[str, Any]) -> Any:
    """The network of a row with the weights that were given, or with those that kornia downloads."""
    if values["weights"]:
        network = row.build(row.creator, values)
        targets = {"weights": network}
        if "descriptor_weights" in values:
            if not values["descriptor_weights"]:
                raise ParameterError(f"{name} needs two files: weights=FILE and descriptor_weights=FILE")
            targets = {"weights": network.detector, "descriptor_weights": network.descriptor}
        for key, module in targets.items():
            load_weights(module, values[key])
        return network
    absent = [f for f in row.files(values) if not cached(f)] if row.files else []
    if absent and not reachable():
        raise PluginUnavailableError(f"{name}: {_no_weights(row, absent)} ({HOST[0]} cannot be reached now)")
    try:
        return row.build(row.creator, values, trained=True)
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        text = " ".join(str(error).split())[:200]
        raise PluginUnavailableError(f"{name}: {_no_weights(row, absent)} (kornia: {text})") from error


def _no_weights(row: KorniaRow, absent: list[str]) -> str:
    names = " and ".join(absent) or "the weights"
    return f"its trained weights are not on this machine; give weights=FILE ({names} from {row.source}) or go online"


def load_weights(module: Any, path: str) -> None:
    """Load trained tensors from a file that holds them under the names that the network has for them.

    Parameters
    ----------
    module : `torch.nn.Module`
    path : file written by `torch.save`; only tensors are read from it, no code is run

    Raises
    ------
    InputError
        The file cannot be read, holds anything else, or is that of another network.
    """
    torch = import_torch()
    import pickle
    import zipfile

    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, KeyError, pickle.UnpicklingError, zipfile.BadZipFile) as error:
        raise InputError(f"weights file {path}: holds no tensors that torch can read; {_reason(error)}") from error
    for key in WRAPPERS:
        if isinstance(found, Mapping) and isinstance(found.get(key), Mapping):
            found = found[key]
    if not isinstance(found, Mapping) or not all(hasattr(value, "shape") for value in found.values()):
        raise InputError(f"weights file {path}: holds {type(found).__name__}, a mapping of names to tensors is needed")
    tensors = _renamed(dict(found), module)
    own = module.state_dict()
    learned = {key for key, _ in module.named_parameters()} | {
        k for k in own if k.endswith(("running_mean", "running_var"))
    }
    absent = sorted(learned - set(tensors))
    other = sorted(k for k in learned & set(tensors) if own[k].shape != tensors[k].shape)
    if absent or other:
        what = f"lacks {len(absent)} of its {len(learned)} tensors" if absent else f"has {len(other)} of another shape"
        raise InputError(
            f"weights file {path}: is not of {type(module).__name__}: {what}, such as '{(absent or other)[0]}'"
        )
    module.load_state_dict({key: value for key, value in tensors.items() if key in own}, strict=False)


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()).split(". ")[0][:120] or type(error).__name__


def _renamed(tensors: dict[str, Any], module: Any) -> dict[str, Any]:
    """The tensors under the names that kornia's modules use for those of the authors."""
    tensors = {key.removeprefix("matcher."): value for key, value in tensors.items()}
    if type(module).__name__ == "LightGlue":
        for part in ("self_attn", "cross_attn"):
            for i in range(module.conf.n_layers):
                old, new = f"{part}.{i}", f"transformers.{i}.{part}"
                tensors = {key.replace(old, new): value for key, value in tensors.items()}
    own = set(module.state_dict())
    if not own & set(tensors):
        # XFeat's file holds the inner network only.
        tensors = {f"net.{key}" if f"net.{key}" in own else key: value for key, value in tensors.items()}
    return tensors


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

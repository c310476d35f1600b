"""Writes the files of translated kernels: run when the package is built or installed, and after a kernel was changed.

    python featreg/runtime/preparing.py [FOLDER] [WORKERS]

FOLDER holds the package `featreg` (default: this one's). For which arguments each kernel is translated stands in
`kernels.json` beside this file; `featreg.warming.record_kernels` writes that. Only numpy and numba are needed, and of
this package only the kernels: no package's `__init__` is run, so that it works where nothing else is installed yet.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any

#: Module of kernels -> kernel -> kinds of the arguments of each call, as `featreg.runtime.precompiled.key_of` has them.
LIST = Path(__file__).with_name("kernels.json")
#: Variables of numba that name the processor for which machine code is made.
PROCESSOR = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_ENABLE_AVX")


def prepare(root: Path, workers: int = 2) -> dict[str, str]:
    """Translate every listed kernel into the file beside its module.

    Parameters
    ----------
    root : folder that holds the package `featreg`
    workers : processes

    Returns
    -------
    what could not be translated -> why; numba compiles it when it is first called
    """
    listed: dict[str, dict[str, list[list[str]]]] = json.loads(LIST.read_text(encoding="utf-8"))
    missing: dict[str, str] = {}
    with ProcessPoolExecutor(workers, get_context("spawn"), _bare, (str(root.resolve()), list(listed))) as pool:
        for one in pool.map(_module, *zip(*listed.items(), strict=True)):
            missing |= one
    return missing


def _bare(root: str, modules: list[str]) -> None:
    """Stand in for the packages above the kernels, whose own code would import what need not be there."""
    # What a developer asks of numba, by variables or by a .numba_config.yaml where this is run, is not for what is
    # handed out; only for which processor is.
    for name in [name for name in os.environ if name.startswith("NUMBA_") and name not in PROCESSOR]:
        del os.environ[name]
    os.chdir(Path(__file__).parent)
    sys.path.insert(0, root)
    for module in modules:
        parts = module.split(".")[:-1]
        for length in range(1, len(parts) + 1):
            name = ".".join(parts[:length])
            if name not in sys.modules:
                package = sys.modules[name] = ModuleType(name)
                package.__path__ = [str(Path(root, *parts[:length]))]


def _module(name: str, kernels: dict[str, list[list[str]]]) -> dict[str, str]:
    """Translate the kernels of one module."""
    # A helper that numba kept on disk is optimised for this processor already, and its loops have become vectors.
    jit: Any = importlib.import_module("featreg.runtime.jit")
    jit.keeping = False
    module = importlib.import_module(name)
    precompiled = importlib.import_module("featreg.runtime.precompiled")
    precompiling = importlib.import_module("featreg.runtime.precompiling")
    numba_error: type[Exception] = importlib.import_module("numba.core.errors").NumbaError
    missing: dict[str, str] = {}
    entries: dict[tuple[str, str], list[object]] = {}
    for called, keys in kernels.items():
        kernel = getattr(module, called, None)
        if kernel is None:
            missing[f"{name}.{called}"] = "there is no such kernel any more"
            continue
        for key in keys:
            try:
                made = precompiling.translated(kernel, tuple(key))
            except (ValueError, numba_error) as error:
                missing[f"{name}.{called}({', '.join(key)})"] = str(error)
                continue
            entries.setdefault((called, precompiled.source_digest(kernel)), []).append(precompiled.ready(made))
    content = precompiled.written(entries, precompiling.llvm_version(), precompiling.triple())
    files = importlib.import_module("featreg.runtime.files")
    files.write_atomic(precompiled.file_of(Path(str(module.__file__))), content)
    return missing


def main() -> None:
    """The command."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2]
    missing = prepare(root, int(sys.argv[2]) if len(sys.argv) > 2 else 2)
    for what, why in missing.items():
        sys.stdout.write(f"{what}: {why}\n")


if __name__ == "__main__":
    main()

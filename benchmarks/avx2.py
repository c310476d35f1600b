"""A benchmark as a processor without AVX-512 runs it, on one that has it.

    python benchmarks/avx2.py pairs.py [the options of pairs.py]

OpenCV, NumPy, OpenBLAS, PyTorch and the compiled kernels are told by their own environment variables to leave the
instructions of 512 bits out. What runs then is their code for AVX2; how fast the processor runs it stays its own.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np


def without_avx512() -> dict[str, str]:
    """The environment variables that keep 512-bit instructions out."""
    features = llvm.get_host_cpu_features()
    # Of the processor's own features only those are named that take these instructions away.
    away = [name for name, there in features.items() if there and ("avx512" in name or "avx10" in name)]
    for name in away:
        features[name] = False
    core = "numpy._core" if hasattr(np, "_core") else "numpy.core"
    dispatched = importlib.import_module(f"{core}._multiarray_umath").__cpu_dispatch__
    dispatched = [name for name in dispatched if "AVX512" in name or name == "X86_V4"]
    return {
        "NUMBA_CPU_NAME": "x86-64-v3",
        "NUMBA_CPU_FEATURES": features.flatten(),
        "NPY_DISABLE_CPU_FEATURES": " ".join(dispatched),
        "OPENBLAS_CORETYPE": "Haswell",
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX512-ICL",
        "ATEN_CPU_CAPABILITY": "avx2",
    }


def main() -> int:
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        print(__doc__)
        return 0
    script = Path(sys.argv[1])
    if not script.is_file():
        script = Path(__file__).with_name(sys.argv[1])
    if not script.is_file():
        print(f"no such benchmark: {sys.argv[1]}; give one of benchmarks/*.py", file=sys.stderr)
        return 2
    return subprocess.run(
        [sys.executable, str(script), *sys.argv[2:]], env={**os.environ, **without_avx512()}, check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main())

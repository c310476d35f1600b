"""Everything about the package stands in pyproject.toml; here only that its kernels are translated while it is built.

FEATREG_KERNELS=numba leaves that out, as it does where the package runs.
"""

import os
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithKernels(build_py):
    """Copies the modules as ever, then writes the translated kernels beside them; in the sources where editable."""

    def run(self) -> None:
        super().run()
        if os.environ.get("FEATREG_KERNELS") == "numba":
            return
        root = Path(__file__).resolve().parent if self.editable_mode else Path(self.build_lib).resolve()
        script = root / "featreg" / "runtime" / "preparing.py"
        done = subprocess.run([sys.executable, str(script), str(root), str(os.cpu_count() or 1)], check=False)
        if done.returncode:
            # The package works without: numba then compiles each kernel when it is first called.
            self.warn("the kernels could not be translated, the first calls will compile them")


setup(cmdclass={"build_py": BuildWithKernels})

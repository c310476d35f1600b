"""Everything about the package stands in pyproject.toml; here its kernels are translated while it is built, and its
README becomes the text of an index page.

FEATREG_KERNELS=numba leaves that out, as it does where the package runs.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.errors import OptionError

#: Each imports numba and LLVM for itself, and Windows has no pools of more than 61.
MOST_WORKERS = 8


class BuildWithKernels(build_py):
    """Copies the modules as ever, then writes the translated kernels beside them; in the sources where editable."""

    def run(self) -> None:
        asked = os.environ.get("FEATREG_KERNELS", "")
        if asked not in ("", "numba", "bitcode"):
            raise OptionError(f"FEATREG_KERNELS is '{asked}', give 'numba' or 'bitcode', or leave it unset")
        super().run()
        root = Path(__file__).resolve().parent if self.editable_mode else Path(self.build_lib).resolve()
        if not self.editable_mode:
            # What lay beside the sources was made for them as they were then, on whichever machine.
            for old in root.rglob("*_kernels.bc"):
                old.unlink()
        if asked == "numba":
            return
        script = root / "featreg" / "runtime" / "preparing.py"
        done = subprocess.run([sys.executable, str(script), str(root), str(worker_count())], check=False)
        if done.returncode:
            # The package works without: numba then compiles each kernel when it is first called.
            self.warn("the kernels could not be translated, the first calls will compile them")


def worker_count() -> int:
    """Processes that translate: one for each processor that this one may use, up to a few."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, MOST_WORKERS)


def index_text(readme: str) -> str:
    """The README without what leads to files beside it: a page of a package index has none, and no picture of ours."""
    without = re.sub(r"^!\[[^\]]*\]\((?!https?:)[^)]*\)\n\n?", "", readme, flags=re.M)
    return re.sub(r"\[([^\]]+)\]\((?!https?:|#)[^)]*\)", r"\1", without)


if __name__ == "__main__":
    setup(
        cmdclass={"build_py": BuildWithKernels},
        long_description=index_text((Path(__file__).parent / "README.md").read_text(encoding="utf-8")),
        long_description_content_type="text/markdown",
    )

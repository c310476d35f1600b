"""LLVM for the processor at hand: what it makes of translated kernels, and where that is kept.

`featreg.runtime.precompiled` hands it the code of a kernel, and machine code where that was prepared for this processor
already. What is made here is kept on disk, one object a kernel, in the folder where numba would keep it.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import logging
import os
import sys
import tempfile
import zlib
from functools import cache
from pathlib import Path
from typing import Any

from featreg.errors import InputError
from featreg.runtime import calling
from featreg.runtime.files import write_atomic

logger = logging.getLogger(__name__)

#: LLVM's option by which loops take as many numbers at a time as the narrowest allow.
BY_NARROWEST = "-vectorizer-maximize-bandwidth"
#: Processors whose AVX numba leaves alone, by LLVM's names.
WITHOUT_AVX = ("corei7-avx", "core-avx-i", "sandybridge", "ivybridge", "nocona")


class Machine:
    """LLVM for the processor at hand."""

    def __init__(self) -> None:
        import llvmlite.binding as llvm

        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self.llvm = llvm
        self.processor = _processor(llvm)
        version = ".".join(map(str, llvm.llvm_version_info))
        told = "\n".join((version, *self.processor, _own_digest()))
        #: Digest of all that decides which machine code becomes of a kernel.
        self.identity = hashlib.sha256(told.encode()).hexdigest()[:32]
        module = llvm.parse_assembly("")
        module.triple = llvm.get_process_triple()
        self.engine = llvm.create_mcjit_compiler(module, self.target())

    def target(self) -> Any:
        """The processor, with the options that numba sets."""
        target = self.llvm.Target.from_triple(self.llvm.get_process_triple())
        processor, features = self.processor
        return target.create_target_machine(
            cpu=processor, features=features, opt=3, reloc="static", codemodel="jitdefault", jit=True
        )

    def takes(self, llvm: list[int], triple: str) -> bool:
        """Whether code of this version of LLVM for this system can be used here."""
        return tuple(llvm) <= tuple(self.llvm.llvm_version_info) and triple == self.llvm.get_process_triple()

    def addresses(
        self, symbol: str, packed: bytes, key: tuple[str, ...], result: str, outputs: tuple[int, ...], made: bytes = b""
    ) -> tuple[int, int] | None:
        """Where the code of a symbol and its entry from Python lie in memory; None where they cannot be made.

        `packed` is LLVM's code and `made` what this machine makes of it, where that is at hand.
        """
        code: bytes | None = None
        with contextlib.suppress(zlib.error):
            code = zlib.decompress(made) if made else None
        if code is None:
            told = "\n".join((self.identity, symbol, repr(outputs))).encode() + packed
            name = f"{symbol[-24:]}-{hashlib.sha256(told).hexdigest()[:16]}.o"
            code = _kept(name)
            if code is None:
                try:
                    code = self.optimised(zlib.decompress(packed), calling.entered(symbol, key, result, outputs))
                except (RuntimeError, zlib.error) as error:
                    logger.warning("the prepared code of %s cannot be used, numba compiles it: %s", symbol, error)
                    return None
                _keep(name, code)
        self.engine.add_object_file(self.llvm.ObjectFileRef.from_data(code))
        self.engine.finalize_object()
        here, entry = (int(self.engine.get_function_address(name)) for name in (symbol, f"{symbol}_call"))
        return (here, entry) if here and entry else None

    def optimised(self, code: bytes, entry: str) -> bytes:
        """The object of LLVM's code, of which `entry` is the text of its entry from Python: numba's own last passes."""
        llvm, target = self.llvm, self.target()
        module, more = llvm.parse_bitcode(code), llvm.parse_assembly(entry)
        more.triple, more.data_layout = module.triple, module.data_layout
        module.link_in(more)
        options = llvm.create_pipeline_tuning_options(speed_level=3)
        # Of what stands side by side without a loop, numba makes no vectors, and is right: rows that advance together
        # would be gathered into one and taken apart again.
        options.loop_vectorization, options.slp_vectorization = True, False
        builder = llvm.create_pass_builder(target, options)
        # By the narrowest numbers of a loop, not by its widest, is counted how many are taken at a time: products of 16
        # bits that are summed in 32 otherwise fill half of a register of AVX2.
        llvm.set_option("featreg", f"{BY_NARROWEST}=true")
        try:
            builder.getModulePassManager().run(module, builder)
        finally:
            # What else is compiled in this process keeps LLVM's usual way.
            llvm.set_option("featreg", f"{BY_NARROWEST}=false")
        return bytes(target.emit_object(module))


def _processor(llvm: Any) -> tuple[str, str]:
    """Name and features of the processor, or of the one that numba's variables name in its place."""
    named, features = os.environ.get("NUMBA_CPU_NAME"), os.environ.get("NUMBA_CPU_FEATURES")
    name = str(llvm.get_host_cpu_name()) if named is None else named
    if features is None and named is not None and named.lower() == "generic":
        features = ""  # but those that are named
    if features is None:
        found = llvm.get_host_cpu_features()
        asked = os.environ.get("NUMBA_ENABLE_AVX", "")
        if asked == "0" or (not asked and (named or str(llvm.get_host_cpu_name())) in WITHOUT_AVX):
            for feature in found:
                found[feature] = found[feature] and not feature.startswith("avx")
        features = found.flatten()
    return name, features


def processor_has(feature: str) -> bool:
    """Whether prepared code is made here for a processor with a feature, by LLVM's name of it."""
    here = machine()
    return here is not None and f"+{feature}" in here.processor[1].split(",")


@cache
def _own_digest() -> str:
    """Digest of this file, whose passes decide on an object, and of that by which code is called."""
    return hashlib.sha256(Path(__file__).read_bytes() + Path(calling.__file__).read_bytes()).hexdigest()


@cache
def machine() -> Machine | None:
    # llvmlite comes with numba; what it cannot do here, numba may.
    if sys.implementation.name != "cpython" or ctypes.sizeof(ctypes.c_void_p) != 8 or not calling.layout_holds():
        return None
    try:
        return Machine()
    except (ImportError, RuntimeError, AttributeError) as error:
        logger.info("no prepared kernels here: %s", error)
        return None


@cache
def folder() -> Path | None:
    """Where objects are kept: the first of numba's places that can be written; None where none can."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    home = os.path.expanduser("~")
    places = [Path(named)] if named else [Path(__file__).parent / "__pycache__"]
    if not named:
        caches = os.environ.get("XDG_CACHE_HOME") or (os.path.join(home, ".cache") if home != "~" else "")
        places += [Path(caches) / "featreg"] if caches else []
    for place in places:
        try:
            (place / "objects").mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=place / "objects"):
                return place / "objects"
        except OSError:
            continue
    return None


def _kept(name: str) -> bytes | None:
    place = folder()
    try:
        content = b"" if place is None else (place / name).read_bytes()
    except OSError:
        return None
    # A disk that filled up may have left less.
    digest, code = content[:32], content[32:]
    return code if content and hashlib.sha256(code).digest() == digest else None


def _keep(name: str, code: bytes) -> None:
    place = folder()
    if place is not None:
        try:
            write_atomic(place / name, hashlib.sha256(code).digest() + code, sync=False)
        except InputError as error:
            logger.info("compiled code is not kept: %s", error)

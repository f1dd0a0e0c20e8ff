"""How `torchjoint._C` is compiled: against the LibTorch stable ABI, so that one binary serves torch >= 2.10."""

import os
import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from setuptools import Extension
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

# The oldest torch version whose symbols may be used. Without this limit the module would fail to load on any torch
# older than the one it was built with.
TORCH_TARGET_VERSION = "0x020a000000000000"
PYTHON_LIMITED_API = "0x030b0000"

#: Relative to the folder of pyproject.toml, where setuptools runs: it takes no absolute paths.
SOURCES = Path("torchjoint/csrc")
# -ffp-contract=off: no fused multiply-add, so every machine gives the same labels.
# -fno-trapping-math: nobody reads the flags of floating-point exceptions; to keep them, GCC leaves many comparisons as
# branches. No value changes. Torch's headers come as those of the system, without warnings about them.
FLAGS = [
    "-std=c++20", "-O3", "-g0", "-fvisibility=hidden", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math",
    "-Wall", "-Wextra",
]  # fmt: skip
# The same for Windows, where nothing is visible but what is exported, and the compiler's driver has other names.
CLANG_CL_FLAGS = [
    "/std:c++20", "/O2", "/EHsc", "/clang:-O3", "/clang:-ffp-contract=off", "/clang:-fno-math-errno",
    "/clang:-fno-trapping-math",
]  # fmt: skip


class BuildStableExtension(build_ext):
    """Adds the source files, torch's headers and libraries, and the flags of the stable ABI to the extension."""

    def finalize_options(self) -> None:
        """Find the source files: an operator is compiled because its file is there."""
        super().finalize_options()
        for ext in self.extensions:
            ext.sources = sorted(path.as_posix() for path in SOURCES.glob("*.cpp"))
            ext.depends = sorted(path.as_posix() for path in SOURCES.glob("*.h"))

    def build_extension(self, ext: Extension) -> None:
        """Compile an extension module."""
        import torch  # imported here, because reading metadata and building an sdist must not need torch

        root = Path(torch.__file__).parent
        includes = (root / "include", root / "include/torch/csrc/api/include")
        ext.library_dirs += [str(root / "lib")]
        # `import torch` comes first and loads libtorch_cpu and libc10, so no rpath to a build folder is needed.
        ext.libraries += ["torch_cpu", "c10"]
        ext.define_macros += [("TORCH_TARGET_VERSION", TORCH_TARGET_VERSION), ("Py_LIMITED_API", PYTHON_LIMITED_API)]
        if self.compiler.compiler_type == "msvc":
            use_clang_cl(self.compiler)
            ext.extra_compile_args += [*CLANG_CL_FLAGS, *(f"/imsvc{path}" for path in includes)]
            ext.extra_link_args += [clang_cl_builtins()]
        else:
            ext.extra_compile_args += [*FLAGS, *(f"-isystem{path}" for path in includes)]
        self.compiler.compile = in_parallel(self.compiler.compile)
        super().build_extension(ext)


def use_clang_cl(compiler: Any) -> None:
    """Makes setuptools call clang-cl in place of MSVC, which has no 128-bit integers, prefetching or vector targets."""
    if shutil.which("clang-cl") is None:
        raise CompileError("expected clang-cl on the PATH (LLVM, or Visual Studio's C++ Clang tools), found none")
    compiler.initialize()
    compiler.cc = "clang-cl"
    compiler.compile_options = [option for option in compiler.compile_options if option != "/GL"]  # MSVC's alone


def clang_cl_builtins() -> str:
    """The library with Clang's 128-bit division and its test of the processor, which MSVC's linker does not know."""
    command = ["clang-cl", "/clang:--rtlib=compiler-rt", "/clang:-print-libgcc-file-name"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def in_parallel(compile: Callable[..., list[str]]) -> Callable[..., list[str]]:
    """The method of a compiler, for several files at once: MAX_JOBS, or as many as there are processors, at most 8."""
    jobs = int(os.environ.get("MAX_JOBS", 0)) or min(os.cpu_count() or 1, 8)

    def compile_all(sources: list[str], **options: Any) -> list[str]:
        with ThreadPoolExecutor(jobs) as pool:
            return [file for files in pool.map(lambda source: compile([source], **options), sources) for file in files]

    return compile_all

"""How `torchjoint._C` is compiled: against the LibTorch stable ABI, so that one binary serves torch >= 2.10."""

from __future__ import annotations

from pathlib import Path

from setuptools import Extension
from setuptools.command.build_ext import build_ext

# The oldest torch version whose symbols may be used. Without this limit the module would fail to load on any torch
# older than the one it was built with.
TORCH_TARGET_VERSION = "0x020a000000000000"
PYTHON_LIMITED_API = "0x030b0000"


class BuildStableExtension(build_ext):
    """Adds torch's headers and libraries to every extension, and the flags of the stable ABI."""

    def build_extension(self, ext: Extension) -> None:
        """Compile one extension module."""
        import torch  # imported here, because reading metadata and building an sdist must not need torch

        root = Path(torch.__file__).parent
        ext.include_dirs += [str(root / "include"), str(root / "include/torch/csrc/api/include")]
        ext.library_dirs += [str(root / "lib")]
        # `import torch` comes first and loads libtorch_cpu and libc10, so no rpath to a build folder is needed.
        ext.libraries += ["torch_cpu", "c10"]
        ext.define_macros += [
            ("TORCH_TARGET_VERSION", TORCH_TARGET_VERSION),
            ("Py_LIMITED_API", PYTHON_LIMITED_API),
        ]
        # -ffp-contract=off: no fused multiply-add, so every machine gives the same labels.
        ext.extra_compile_args += [
            "-std=c++20",
            "-O3",
            "-g0",
            "-fvisibility=hidden",
            "-ffp-contract=off",
            "-fno-math-errno",
            "-Wall",
        ]
        super().build_extension(ext)

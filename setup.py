"""Builds the optional C kernel; everything else is in pyproject.toml.

Without a working compiler the install still succeeds: the compiler's complaint is kept in
``build_error.txt`` beside the backend, which quotes it when asked why it is unavailable.
"""

from __future__ import annotations

import runpy
import tempfile
from pathlib import Path

from setuptools import setup
from setuptools.command.build_ext import build_ext

KERNEL = Path("tsplat") / "backends" / "cffi"
MSVC_FLAGS = ["/O2", "/fp:precise"]
# -ffp-contract=off keeps float results the same on every machine; the two -fno- flags only drop
# errno and floating-point traps, which nothing here reads, and let loops vectorise.
FLAGS = ["-O3", "-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
OPENMP_PROBE = "#include <omp.h>\nint main(void) { return omp_get_max_threads() < 1; }\n"


class BuildKernel(build_ext):
    """``build_ext`` that probes for OpenMP and outlives a missing compiler."""

    def _has_openmp(self) -> bool:
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "probe.c"
            source.write_text(OPENMP_PROBE)
            try:
                objects = self.compiler.compile(
                    [str(source)], output_dir=folder, extra_postargs=["-fopenmp"]
                )
                self.compiler.link_executable(
                    objects, str(Path(folder) / "probe"), extra_postargs=["-fopenmp"]
                )
            except Exception:  # any complaint means no
                return False
        return True

    def build_extension(self, ext):
        """Builds ``ext``, or writes down why that failed."""
        root = Path() if self.inplace else Path(self.build_lib)
        report = root / KERNEL / "build_error.txt"
        report.unlink(missing_ok=True)
        if self.compiler.compiler_type == "msvc":
            ext.extra_compile_args = MSVC_FLAGS
        else:
            openmp = ["-fopenmp"] if self._has_openmp() else []
            ext.extra_compile_args = FLAGS + openmp
            ext.extra_link_args = openmp
        try:
            super().build_extension(ext)
        except Exception as error:
            report.parent.mkdir(parents=True, exist_ok=True)
            report.write_text(f"{type(error).__name__}: {error}\n")
            self.warn(f"the C kernel was not built ({error}); tsplat works without it, slower")


build = runpy.run_path(str(KERNEL / "build.py"))
kernel = build["make_ffi"]([], []).distutils_extension(tmpdir="build")
kernel.optional = True
setup(ext_modules=[kernel], cmdclass={"build_ext": BuildKernel})

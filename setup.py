"""Builds what is in C and optional: kernel, decoder, unpacker, encoder.

All else is in pyproject.toml.
Without a working compiler the install still succeeds: the compiler's complaint is kept in
``NAME.build_error.txt`` beside what was not built; the backend quotes its own when asked why it is
unavailable.
"""

from __future__ import annotations

import os
import re
import runpy
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

from setuptools import setup
from setuptools.command.build_ext import build_ext

KERNEL = Path("tsplat") / "backends" / "cffi"
MSVC_FLAGS = ["/O2", "/fp:precise"]
# -ffp-contract=off keeps float results the same on every machine; the two -fno- flags only drop
# errno and floating-point traps, which nothing here reads, and let loops vectorise.
FLAGS = ["-O3", "-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
OPENMP_PROBE = "#include <omp.h>\nint main(void) { return omp_get_max_threads() < 1; }\n"


@contextmanager
def complaints(kept: list[str]):
    """Passes on what is written to stderr meanwhile, and keeps its lines that tell of errors."""
    with tempfile.TemporaryFile() as stream:
        sys.stderr.flush()
        before = os.dup(2)
        os.dup2(stream.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(before, 2)
            os.close(before)
            stream.seek(0)
            text = stream.read().decode(errors="replace")
            sys.stderr.write(text)
            kept += [line.strip() for line in text.splitlines() if "error" in line.lower()][:3]


class BuildKernel(build_ext):
    """``build_ext`` that probes for OpenMP and outlives a missing compiler."""

    def _has_openmp(self) -> bool:
        with tempfile.TemporaryDirectory() as folder, complaints([]):
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
        *package, name = ext.name.split(".")
        report = root.joinpath(*package, f"{name}.build_error.txt")
        report.unlink(missing_ok=True)
        if self.compiler.compiler_type == "msvc":
            ext.extra_compile_args = MSVC_FLAGS
        else:
            openmp = ["-fopenmp"] if self._has_openmp() else []
            ext.extra_compile_args = FLAGS + openmp
            ext.extra_link_args = openmp
        kept: list[str] = []
        try:
            with complaints(kept):
                super().build_extension(ext)
        except Exception as error:
            # A command line of thirty flags says less than the compiler's name.
            cause = re.sub(
                r"[Cc]ommand '?\[?'?([^', ]+).*?\]?'? (failed|returned)", r"\1 \2", str(error)
            )
            report.parent.mkdir(parents=True, exist_ok=True)
            report.write_text("\n".join([cause, *kept]) + "\n")
            self.warn(f"{ext.name} was not built ({cause}); tsplat works without it, slower")


build = runpy.run_path(str(KERNEL / "build.py"))
modules = [
    build["make_ffi"]([], [], build[name]).distutils_extension(tmpdir="build")
    for name in ("MODULE", "DECODER", "UNPACKER", "ENCODER")
]
for module in modules:
    module.optional = True
setup(ext_modules=modules, cmdclass={"build_ext": BuildKernel})

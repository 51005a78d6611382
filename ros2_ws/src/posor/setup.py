# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packaging for colcon and pip by ``setup.cfg``, and the library of the kernels (``posor/kernel_build.py``).

The library is built where numba and a C compiler are installed; of a source release, which holds the assembler text in
``kernels``, by the C compiler alone. Without the library numba compiles the kernels at each start, or they are Python.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.develop import develop
from setuptools.command.sdist import sdist

SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}
TEXTS = Path(__file__).parent / "kernels"  # of a source release
BUILT = os.environ.get("POSOR_KERNEL_LIBRARY", "")  # a library that is taken if it is of the same sources


def run_kernel_build(metadata: Path, *arguments: str) -> bool:
    """Run the program that builds the library, or print why it cannot run here; ``metadata``: folder of egg-info."""
    missing = [name for name in ("numba", "scipy", "pinocchio", "pydantic") if find_spec(name) is None]
    if shutil.which(os.environ.get("CC", "cc")) is None:
        missing.append("a C compiler")
    if missing and not (TEXTS.is_dir() and "a C compiler" not in missing):
        sys.stderr.write(f"posor: the kernels are not built, because {', '.join(missing)} is not installed\n")
        return False
    path = os.pathsep.join([str(metadata), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "posor.kernel_build", *arguments]
    subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, check=True)
    return True


class BuildPy(build_py):
    """Adds the library to the package."""

    def run(self) -> None:
        """Run the command."""
        super().run()
        if not self.editable_mode:
            self.run_command("egg_info")
            metadata = Path(self.get_finalized_command("egg_info").egg_base)
            library = Path(self.build_lib, "posor", "posor_kernels.so")
            if BUILT:
                shutil.copyfile(BUILT, library)
            run_kernel_build(metadata, str(library))


class Develop(develop):
    """Puts the library into the folder in which colcon builds; the package is linked to its sources there."""

    def run(self) -> None:
        """Run the command."""
        super().run()
        if not self.uninstall:
            run_kernel_build(Path.cwd(), str(Path.cwd() / "posor_kernels.so"))


class Sdist(sdist):
    """Adds the assembler text."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Make the folder of the release."""
        super().make_release_tree(base_dir, files)
        metadata = Path(self.get_finalized_command("egg_info").egg_base)
        run_kernel_build(
            metadata, str(Path(SCRATCH.name, "posor_kernels.so")), "--texts", str(Path(base_dir, "kernels"))
        )


class BdistWheel(bdist_wheel):
    """Names the platform and no version of Python: the library does not use Python."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return Python, its interface, and the platform."""
        return "py3", "none", super().get_tag()[2]


class BinaryDistribution(Distribution):
    """A distribution for one platform."""

    def has_ext_modules(self) -> bool:
        """Return that the distribution holds machine code."""
        return True


setup(
    python_requires=">=3.11",
    cmdclass={"build_py": BuildPy, "develop": Develop, "sdist": Sdist, "bdist_wheel": BdistWheel},
    distclass=BinaryDistribution,
    options={} if "develop" in sys.argv else OPTIONS,
)

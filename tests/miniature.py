# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A small checkout for tests of the set-up: the real tools, one small ROS package, the libraries of this checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path
from textwrap import dedent

from environment import OTHER_ROS_VARIABLES, PATH_LISTS, THIS, Workspace

BASE_PYTHON = Path(sys.base_prefix, "bin", f"python{sys.version_info.major}.{sys.version_info.minor}")
PACKAGE = "miniature"

SETUP_PY = """
    from setuptools import setup

    setup(
        name="miniature",
        version="1.0.0",
        packages=["miniature"],
        data_files=[
            ("share/ament_index/resource_index/packages", ["resource/miniature"]),
            ("share/miniature", ["package.xml"]),
            ("share/miniature/config", ["config/numbers.txt"]),
        ],
        entry_points={
            "console_scripts": ["tell = miniature.programs:tell", "wait = miniature.programs:wait"],
            "miniature.things": ["answer = miniature.programs:ANSWER"],
        },
    )
"""
PROGRAMS = """
    import importlib.metadata
    import os
    import signal
    import sys

    ANSWER = 42


    def tell():
        things = importlib.metadata.entry_points(group="miniature.things")
        print("arguments", *sys.argv[1:])
        print("things", *(thing.load() for thing in things))
        print("prefixes", os.environ["AMENT_PREFIX_PATH"])


    def wait():
        signal.signal(signal.SIGINT, lambda *_: sys.exit(7))
        print(os.getpid(), flush=True)
        while True:
            signal.pause()
"""
MANIFEST = """\
    <?xml version="1.0"?>
    <package format="3">
      <name>miniature</name>
      <version>1.0.0</version>
      <description>One small package.</description>
      <maintainer email="maintainers@posor.invalid">POSOR maintainers</maintainer>
      <license>Apache-2.0</license>
      <export><build_type>ament_python</build_type></export>
    </package>
"""


def clean_environ(**extra: str) -> dict[str, str]:
    """Return the environment without the workspace of the tests."""
    lists = {name: os.environ[name].split(os.pathsep) for name in PATH_LISTS if name in os.environ}
    outside = {name: [p for p in paths if not Path(p).is_relative_to(THIS.root)] for name, paths in lists.items()}
    environ = {name: value for name, value in os.environ.items() if name not in PATH_LISTS}
    environ |= {name: os.pathsep.join(paths) for name, paths in outside.items() if paths}
    if "AMENT_PREFIX_PATH" not in environ:
        removed = {*OTHER_ROS_VARIABLES, "ROS_DISTRO", "ROS_VERSION", "ROS_PYTHON_VERSION"}
        environ = {name: value for name, value in environ.items() if name not in removed}
    environ.pop("PYTHON", None)
    return environ | extra


class Miniature(Workspace):
    """A checkout in an empty folder whose set-up needs no network."""

    def fill(self) -> None:
        ignored = shutil.ignore_patterns("__pycache__", "wheel_packages")
        shutil.copytree(THIS.root / "tools", self.root / "tools", ignore=ignored)
        shutil.copy(THIS.root / "run", self.root / "run")
        for path in (THIS.root / "requirements").iterdir():
            self.write(f"requirements/{path.name}", "")
        self.write("requirements/build.txt", "borrowed==1.0\n")
        self.write("requirements/build.in", "borrowed\n")
        wheel = self.root / "wheels" / "borrowed-1.0-py3-none-any.whl"
        wheel.parent.mkdir()
        with zipfile.ZipFile(wheel, "w") as archive:
            archive.writestr("borrowed.pth", f"{sysconfig.get_path('purelib')}\n")
            archive.writestr("borrowed-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: borrowed\nVersion: 1.0\n")
            archive.writestr("borrowed-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
            archive.writestr("borrowed-1.0.dist-info/RECORD", "")
        package = f"ros2_ws/src/{PACKAGE}"
        scripts = "$base/lib/miniature"
        self.write(f"{package}/package.xml", MANIFEST)
        self.write(f"{package}/setup.py", SETUP_PY)
        self.write(f"{package}/setup.cfg", f"[develop]\nscript_dir={scripts}\n[install]\ninstall_scripts={scripts}\n")
        self.write(f"{package}/resource/miniature", "")
        self.write(f"{package}/config/numbers.txt", "1 2 3\n")
        self.write(f"{package}/miniature/__init__.py", "")
        self.write(f"{package}/miniature/programs.py", PROGRAMS)

    def write(self, name: str, text: str) -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text), encoding="utf-8")
        return path

    def environ(self, **extra: str) -> dict[str, str]:
        """Return the environment of its processes, in which pip finds only that wheel."""
        return clean_environ(**{"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(self.root / "wheels"), **extra})

    def start(self, *command: str | Path, **extra: str) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command, env=self.environ(**extra), stdout=pipe, stderr=pipe, text=True, start_new_session=True
        )

    def start_set_up(self, **extra: str) -> subprocess.Popen[str]:
        tools = self.root / "tools"
        return self.start(tools / "python.sh", tools / "setup_workspace.py", **{"PYTHON": str(BASE_PYTHON), **extra})

    def set_up(self, **extra: str) -> subprocess.CompletedProcess[str]:
        process = self.start_set_up(**extra)
        out, err = process.communicate()
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def run(self, *arguments: str, **extra: str) -> subprocess.CompletedProcess[str]:
        command = [str(self.root / "run"), *arguments]
        return subprocess.run(command, env=self.environ(**extra), capture_output=True, text=True, check=False)

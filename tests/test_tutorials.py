# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every command and Python block of docs/tutorials, run as a reader would: in bash, one block after the other."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from environment import THIS, read_stamp, split_paths

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "tutorials"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"# (build/[\w/]+\.py)\n")
"""First line of a Python block: the file that the reader saves it as."""
FIRST = "first_pose"  # its files are used by other tutorials
SAID: dict[str, list[str]] = yaml.safe_load(Path(__file__).with_name("tutorials.yaml").read_text(encoding="utf-8"))
"""Patterns of the output of each tutorial."""
LONG = ("calibrate", "calibrate_a_simulated_joint", "your_own_arm", "your_own_sensor", "close_a_loop")


def read_page(page: str) -> tuple[str, dict[str, str]]:
    """Return the commands of a page, and its Python blocks by file name."""
    commands, files = "", {}
    for language, block in BLOCK.findall((PAGES / f"{page}.md").read_text(encoding="utf-8")):
        name = FILE.match(block)
        if language == "sh":
            commands += block
        elif language != "text":  # an overview that the page repeats step by step
            assert language == "python", block
            assert name, block
            files[name[1]] = block
    return commands, files


def readers_environment() -> dict[str, str]:
    """Return this environment without what the workspace has added to it, as the shell of a reader has it."""
    added = read_stamp(THIS.build_stamp)
    environ = {name: value for name, value in os.environ.items() if name not in added["set"]}
    for name, own in added["prepend"].items():
        environ[name] = os.pathsep.join(path for path in split_paths(environ.get(name, "")) if path not in own)
    return environ | {"MPLBACKEND": "agg", "COLUMNS": "200"}


def run_in(folder: Path, commands: str, files: dict[str, str]) -> str:
    """Run commands in a folder that looks like the checkout but has a ``build`` of its own; return their output."""
    for entry in ROOT.iterdir():
        if entry.name != "build":
            (folder / entry.name).symlink_to(entry)
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    process = subprocess.Popen(
        ["/bin/bash", "-e", "-c", commands],
        cwd=folder,
        env=readers_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate()
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # whatever a failed script has left
    assert process.returncode == 0, output
    return output


@pytest.mark.parametrize("page", [pytest.param(page, marks=[pytest.mark.long] * (page in LONG)) for page in SAID])
def test_every_block_runs(page: str, tmp_path: Path) -> None:
    _, shared = read_page(FIRST)
    commands, files = read_page(page)
    output = run_in(tmp_path, commands, shared | files)
    for pattern in SAID[page]:
        assert re.search(pattern, output), output
    assert "Traceback" not in output


def test_the_folder_of_every_file_is_made_by_a_command() -> None:
    first, _ = read_page(FIRST)
    for page in SAID:
        commands, files = read_page(page)
        made = " ".join(re.findall(r"mkdir -p (.*)", first + commands)).split()
        assert {str(Path(name).parent) for name in files} <= set(made), page


def test_every_tutorial_is_run() -> None:
    assert sorted(SAID) == sorted(page.stem for page in PAGES.glob("*.md"))

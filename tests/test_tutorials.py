"""Every command and Python block of docs/tutorials, run as a reader would: in bash, one block after the other."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "tutorials"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"# (build/[\w/]+\.py)\n")
"""First line of a Python block: the file that the reader saves it as."""
FIRST = "first_pose"
"""Its files are used by other tutorials."""
SAID = {
    "first_pose": [r"z = -?\d+\.\d{4} mm, standard uncertainty \d+\.\d\d um"],
    "your_own_arm": [r"x = 85\d\.\d{4} mm, standard uncertainty 2\d\.\d\d um", r"expected .*\.\nexit code 1"],
    "your_own_sensor": [r"z = 750\.\d\d um, standard uncertainty 0\.7\d um", r"draw_wire\.yaml.*\.\nexit code 1"],
    "your_own_instrument": [
        r"box: Box 1, 11 channels; \d+\.\d+ frames per second",
        r"z = -?\d+\.\d{4} mm, standard uncertainty \d+\.\d\d um",
        r"box: no connection to 127\.0\.0\.1:5025.*\nexit code 1",
    ],
    "calibrate": [r"zero_drift", r"3 of \d+ numbers differ", r"no topic /laser; expected .*\.\nexit code 1"],
    "analyse_in_a_notebook": [r"1986 poses", r"endpoint 1986"],
    "close_a_loop": [r"moving\nstopped: .+", r"rms distance: \d+\.\d um\n(.*\n)*rms distance: \d+\.\d um\n"],
}
"""Output of each tutorial."""
LONG = ("calibrate", "your_own_arm", "your_own_sensor", "close_a_loop")


def read_page(page: str) -> tuple[str, dict[str, str]]:
    """Return the commands of a page, and its Python blocks by file name."""
    commands, files = "", {}
    for language, block in BLOCK.findall((PAGES / f"{page}.md").read_text(encoding="utf-8")):
        name = FILE.match(block)
        if language == "sh":
            commands += block
        else:
            assert language == "python", block
            assert name, block
            files[name[1]] = block
    return commands, files


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
        env={**os.environ, "MPLBACKEND": "agg", "COLUMNS": "200"},
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


@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", [pytest.param(page, marks=[pytest.mark.long] * (page in LONG)) for page in SAID])
def test_every_block_runs(page: str, tmp_path: Path) -> None:
    _, shared = read_page(FIRST)
    commands, files = read_page(page)
    output = run_in(tmp_path, commands, shared | files)
    for pattern in SAID[page]:
        assert re.search(pattern, output), output
    assert "Traceback" not in output


def test_every_tutorial_is_run() -> None:
    assert sorted(SAID) == sorted(page.stem for page in PAGES.glob("*.md"))

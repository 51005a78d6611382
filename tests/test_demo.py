# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The demo as a program: output, report, exit code, end of its processes."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from posor_lab.harness.case_tables import edited
from posor_lab.replay_1985.replay import TOPICS

from tests.rig_messages import read_bag_messages

Demo = Callable[..., subprocess.Popen[str]]

DEMO = Path(get_package_prefix("posor_lab"), "lib", "posor_lab", "demo")
FIRST_STEP = "   1     0.0"


@pytest.fixture
def installed_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put copies of the packages' files before the installed ones, and let the demo choose its domain."""
    prefix = tmp_path / "prefix"
    packages = prefix / "share" / "ament_index" / "resource_index" / "packages"
    packages.mkdir(parents=True)
    for package in ("posor_bringup", "posor_lab"):
        shutil.copytree(get_package_share_directory(package), prefix / "share" / package)
        (packages / package).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{prefix}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    monkeypatch.delenv("ROS_DOMAIN_ID")
    return prefix / "share"


@pytest.fixture
def demo(tmp_path: Path, installed_files: Path) -> Iterator[Demo]:
    """Return a function that starts the demo with options; after the test no process may be left."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        command = [str(DEMO), "--output", str(tmp_path / "report"), *arguments]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate()
    assert processes_with_files_in(tmp_path) == {}
    assert installed_files.is_dir()


def processes_with_files_in(folder: Path) -> dict[int, str]:
    """Return the command lines that name something in a folder, by process."""
    lines = {}
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = entry.read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # the process has ended meanwhile
            continue
        if str(folder) in line:
            lines[int(entry.parent.name)] = line
    return lines


def wait_for_first_step(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    assert any(line.startswith(FIRST_STEP) for line in process.stdout)


def test_the_demo_holds_and_writes_its_report(demo: Demo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")  # the middleware of a user, unlike all other tests
    process = demo("--rate", "0")
    out, err = process.communicate()
    assert err == ""
    assert process.returncode == 0
    assert out.splitlines()[-1] == "The comparison holds."
    assert "FAILS" not in out
    folder = tmp_path / "report" / "ymo_printed"
    names = {path.name for path in folder.iterdir()}
    assert names == {".results.json", "bag", "logs", "report.html", "steps.csv"}
    assert "The comparison holds." in (folder / "report.html").read_text(encoding="utf-8")
    with (folder / "steps.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == [str(number) for number in range(1, 16)]
    assert float(rows[-1]["beta_posor_urad"]) == pytest.approx(4191.0, abs=1.0)
    assert rows[13]["status"] == "degraded:FLAGGED+diodes_estimated"
    assert {topic: len(messages) for topic, messages in read_bag_messages(folder / "bag").items()} == dict.fromkeys(
        TOPICS, 15
    )


def replace_in(path: Path, old: str, new: str) -> Path:
    path.write_text(edited(path.read_text(encoding="utf-8"), old, new), encoding="utf-8")
    return path


@pytest.mark.long
def test_a_failed_comparison_gives_exit_code_1(demo: Demo, tmp_path: Path, installed_files: Path) -> None:
    table = installed_files / "posor_lab" / "data" / "ymo_output.csv"
    replace_in(table, "\n9,0,52,2564,2497,", "\n9,0,52,2564,2499,")
    process = demo("--rate", "0")
    out, err = process.communicate()
    assert (process.returncode, err) == (1, "")
    assert out.splitlines()[-1] == "The comparison does not hold."
    (failed,) = (line for line in out.splitlines() if line.startswith("FAILS"))
    assert "beta: POSOR - printed POSOR column: 2.21 urad; limit at most 1 urad" in failed
    page = (tmp_path / "report" / "ymo_printed" / "report.html").read_text(encoding="utf-8")
    assert "The comparison does not hold." in page


@pytest.mark.long
def test_a_refusal_of_a_node_is_reported(demo: Demo, installed_files: Path) -> None:
    folder = installed_files / "posor_bringup" / "config"
    calibration = replace_in(folder / "slocum1985_printed.yaml", "version: 1\n", "version: 7\n")
    process = demo()
    _, err = process.communicate()
    assert (process.returncode, err.count("\n")) == (1, 1)
    assert err.startswith(f"posor_node: ended with exit code 1: {calibration}, line 3, key version: version 7; ")


@pytest.mark.long
def test_a_node_that_dies_is_reported(demo: Demo, tmp_path: Path) -> None:
    process = demo("--rate", "0.2")
    wait_for_first_step(process)
    victims = [pid for pid, line in processes_with_files_in(tmp_path / "prefix").items() if "/posor_node " in line]
    assert len(victims) == 1
    os.kill(victims[0], signal.SIGKILL)
    _, err = process.communicate()
    assert process.returncode == 1
    assert err.startswith("posor_node: was ended by SIGKILL; log: ")
    assert err.count("\n") == 1


@pytest.mark.long
def test_an_interrupted_demo_ends_all_programs(demo: Demo, tmp_path: Path) -> None:
    process = demo("--rate", "0.2")
    wait_for_first_step(process)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate()
    assert process.returncode == 130
    assert err == "demo: interrupted.\n"
    bag = read_bag_messages(tmp_path / "report" / "ymo_printed" / "bag")
    assert bag[TOPICS[0]]
    assert (tmp_path / "report" / "ymo_printed" / "bag" / "metadata.yaml").is_file()

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interrupted and killed: what processes of reprocess leave, which is nothing but bags that are whole."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from posor.arm_names import find_arm
from posor.bags.result_folder import UNFINISHED
from posor_bringup.arms import load_checked_arm
from posor_lab.benchmark.offline_benchmark import repeat_bag
from posor_lab.harness.program import Program, installed, wait_until, writes_below

BAG = Path(__file__).resolve().parents[1] / "bags" / "five_axis"
ARM = ["--arm", str(find_arm("five_axis"))]
INTERRUPTED = "reprocess: interrupted; what was not finished is not there."
LONG = ("b", "c", "d")
WAYS = pytest.mark.parametrize(
    ("number", "to"),
    [
        (signal.SIGINT, "group"),
        pytest.param(signal.SIGINT, "parent", marks=pytest.mark.long),
        pytest.param(signal.SIGTERM, "parent", marks=pytest.mark.long),
    ],
)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of bags: one is soon done, the others are not."""
    folder = tmp_path_factory.mktemp("bags")
    repeat_bag(load_checked_arm("five_axis"), BAG, folder / "a", 1)
    repeat_bag(load_checked_arm("five_axis"), BAG, folder / LONG[0], 40)
    for name in LONG[1:]:
        shutil.copytree(folder / LONG[0], folder / name)
    return folder


def program(bags: Path, names: tuple[str, ...], output: Path) -> Program:
    given = [*(str(bags / name) for name in names), *ARM, "--output", str(output), "--jobs", "2"]
    return Program(["setsid", *installed("posor", "reprocess"), *given])


def children(run: Program) -> list[int]:
    """Return the processes that the program has started and that are not ended."""
    pid = run.process.pid
    try:
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def workers(run: Program) -> list[int]:
    """Return those of them that reprocess bags."""
    return [pid for pid in children(run) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def at_work(run: Program) -> list[int]:
    """Return those that are writing results."""
    return [pid for pid in workers(run) if writes_below(pid, UNFINISHED)]


def reports(run: Program) -> list[str]:
    """Return the lines on standard error without the progress, which comes on a slow host."""
    return [line for line in run.stderr if not line.startswith("bags: ")]


def there(output: Path) -> list[str]:
    return sorted(path.name for path in output.iterdir())


def send(run: Program, number: signal.Signals, to: str) -> None:
    (os.killpg if to == "group" else os.kill)(run.process.pid, number)


@WAYS
def test_an_interrupt_ends_all_at_once(bags: Path, tmp_path: Path, number: signal.Signals, to: str) -> None:
    output = tmp_path / "out"
    with program(bags, ("a", *LONG), output) as run:
        run.wait_for_line(f"written to {output / 'a'}")
        wait_until(lambda: len(at_work(run)) == 2, "two bags in the making after the first")
        pids = children(run)
        send(run, number, to)
        assert run.wait() == 130
        assert reports(run) == [INTERRUPTED]
        assert [line for line in run.stdout if "written to" in line] == [f"written to {output / 'a'}"]
    assert there(output) == ["a"]
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "the end of all processes")


@WAYS
def test_an_interrupt_during_the_start_ends_all(bags: Path, tmp_path: Path, number: signal.Signals, to: str) -> None:
    with program(bags, LONG, tmp_path / "out") as run:
        wait_until(lambda: len(workers(run)) == 2, "two processes")
        send(run, number, to)
        assert run.wait() == 130
        assert reports(run) == [INTERRUPTED]
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def started(bags: Path, tmp_path: Path) -> Iterator[Program]:
    with program(bags, LONG, tmp_path / "out") as run:
        wait_until(lambda: len(at_work(run)) == 2, "two bags in the making")
        yield run
    assert there(tmp_path / "out") == []


@pytest.mark.long
def test_repeated_interrupts_do_not_disturb_the_clean_up(started: Program) -> None:
    for _ in range(5):
        send(started, signal.SIGINT, "group")
    assert started.wait() == 130
    assert reports(started) == [INTERRUPTED]


def test_an_interrupt_of_one_bag_leaves_nothing(bags: Path, tmp_path: Path) -> None:
    output = tmp_path / "results" / "out"
    with program(bags, ("b",), output) as run:
        wait_until(lambda: any(output.parent.glob(f"{UNFINISHED}*/new/out/*.mcap")), "a bag in the making")
        assert run.end(signal.SIGTERM) == 130
        assert reports(run) == [INTERRUPTED]
    assert there(output.parent) == []


@pytest.mark.long
def test_a_killed_process_is_reported_with_the_unfinished_bags(bags: Path, started: Program) -> None:
    os.kill(at_work(started)[0], signal.SIGKILL)
    assert started.wait() == 1
    assert not any("written to" in line for line in started.stdout)
    (said,) = reports(started)
    assert said == (
        f"{bags / 'b'}, {bags / 'c'}, {bags / 'd'}: not finished, since a process of the program was ended by "
        "signal 9, Killed; expected memory for as many bags at a time, or a smaller --jobs."
    )


@pytest.mark.long
def test_processes_end_when_the_program_is_killed(started: Program) -> None:
    pids = workers(started)
    send(started, signal.SIGKILL, "parent")
    assert started.wait() == -signal.SIGKILL
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "the end of all processes")
    # Python's own resource tracker reports the semaphores of the killed program; the workers say nothing.
    assert all("resource_tracker" in line or line.startswith("  warnings.warn") for line in started.stderr)

"""Bags reprocessed on a real Dask cluster, one of whose two workers is killed at its work."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from posor_bringup.arms import find_arm, load_checked_arm
from posor_estimator.bags.reprocess_command import main
from posor_estimator.bags.result_folder import UNFINISHED
from posor_estimator.testing.program import Program, installed, wait_until
from posor_validation.benchmark.offline_benchmark import repeat_bag

if TYPE_CHECKING:
    from collections.abc import Iterator

BAG = Path(__file__).resolve().parents[1] / "bags" / "five_axis"
ARM = ["--arm", str(find_arm("five_axis"))]
BAGS = ("a", "b", "c")
LOCAL = {"DASK_DISTRIBUTED__DASHBOARD__LINK": "", "DASK_DISTRIBUTED__COMM__RETRY__COUNT": "0"}


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for number, name in enumerate(BAGS):
        repeat_bag(load_checked_arm("five_axis"), BAG, folder / name, 6 + number)
    return folder


def part(name: str, *arguments: str) -> list[str]:
    """Return the command of a scheduler or a worker."""
    return [sys.executable, "-m", f"distributed.cli.dask_{name}", "--no-dashboard", *arguments]


def address_of(scheduler: Program) -> str:
    return next(word for word in scheduler.wait_for_line("Scheduler at:").split() if word.startswith("tcp://"))


def at_work(worker: Program) -> bool:
    """Return whether a worker is writing results."""
    for entry in Path(f"/proc/{worker.process.pid}/fd").iterdir():
        try:
            if UNFINISHED in str(entry.readlink()):
                return True
        except OSError:  # closed meanwhile
            continue
    return False


def files(folder: Path) -> Iterator[tuple[str, bytes]]:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            yield str(path.relative_to(folder)), path.read_bytes()


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_results_are_whole_and_the_same_though_a_worker_is_killed(bags: Path, tmp_path: Path) -> None:
    given = [*(str(bags / name) for name in BAGS), *ARM]
    assert main([*given, "--output", str(tmp_path / "alone")]) == 0
    with ExitStack() as stack:
        scheduler = stack.enter_context(Program(part("scheduler", "--host", "127.0.0.1", "--port", "0"), LOCAL))
        address = address_of(scheduler)
        options = ["--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path / "spill")]
        workers = [stack.enter_context(Program(part("worker", address, *options), LOCAL)) for _ in range(2)]
        for worker in workers:
            worker.wait_for_line("Registered to:")
        command = [*given, "--output", str(tmp_path / "cluster"), "--scheduler", address]
        client = stack.enter_context(Program([*installed("posor_estimator", "reprocess"), *command]))
        wait_until(lambda: any(map(at_work, workers)), "a worker at work", lambda: time.sleep(0.01))
        victim = next(worker for worker in workers if at_work(worker))
        os.kill(victim.process.pid, signal.SIGKILL)
        assert victim.wait() == -signal.SIGKILL
        assert any((tmp_path / "cluster").glob(f"{UNFINISHED}*"))
        assert client.process.wait(240) == 0, client.stderr
    assert sorted(path.name for path in (tmp_path / "cluster").iterdir()) == list(BAGS)
    assert dict(files(tmp_path / "cluster")) == dict(files(tmp_path / "alone"))

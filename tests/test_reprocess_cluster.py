# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags reprocessed on real Dask clusters: one of two workers is killed at its work; TLS with certificates."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import dask
import pytest
from posor.arm_names import find_arm
from posor.bags.reprocess_command import main
from posor.bags.result_folder import UNFINISHED
from posor.lazy_program import EXIT_INTERRUPTED
from posor_bringup.arms import load_checked_arm
from posor_lab.benchmark.offline_benchmark import repeat_bag
from posor_lab.harness.full_disk import contents_of
from posor_lab.harness.program import Program, installed, wait_until, writes_below
from posor_lab.harness.rig_files import bag_path, calibration_path

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / "bags" / "five_axis"
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
    return scheduler.wait_for_line("Scheduler at:").split()[-1]


def at_work(worker: Program) -> bool:
    return writes_below(worker.process.pid, UNFINISHED)


@pytest.mark.long
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
        client = stack.enter_context(Program([*installed("posor", "reprocess"), *command]))
        wait_until(lambda: any(map(at_work, workers)), "a worker at work")
        victim = next(worker for worker in workers if at_work(worker))
        os.kill(victim.process.pid, signal.SIGKILL)
        assert victim.wait() == -signal.SIGKILL
        assert any((tmp_path / "cluster").glob(f"{UNFINISHED}*"))
        assert client.process.wait(240) == 0, client.stderr
    assert sorted(path.name for path in (tmp_path / "cluster").iterdir()) == list(BAGS)
    assert contents_of(tmp_path / "cluster") == contents_of(tmp_path / "alone")


@pytest.mark.long
def test_an_interruption_is_one_line_and_leaves_no_results(bags: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        scheduler = stack.enter_context(Program(part("scheduler", "--host", "127.0.0.1", "--port", "0"), LOCAL))
        address = address_of(scheduler)
        options = ["--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path / "spill")]
        worker = stack.enter_context(Program(part("worker", address, *options), LOCAL))
        worker.wait_for_line("Registered to:")
        given = [*(str(bags / name) for name in BAGS), *ARM, "--output", str(tmp_path / "out"), "--scheduler", address]
        client = stack.enter_context(Program([*installed("posor", "reprocess"), *given]))
        wait_until(lambda: at_work(worker), "a worker at work")
        assert client.end(signal.SIGINT) == EXIT_INTERRUPTED
        assert client.errors[-1] == "reprocess: interrupted; what was not finished is not there."
        assert not any("Traceback" in line for line in client.errors)


@pytest.fixture
def certificates(tmp_path: Path) -> Iterator[Path]:
    """Return the folder of certificates made by the example; Dask's configuration is restored afterwards."""
    folder = tmp_path / "certificates"
    subprocess.run([ROOT / "examples/security/make_dask_certificates.sh", folder], check=True)
    yield folder
    dask.config.refresh()


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    assert main(arguments) == 2
    return capsys.readouterr().err.strip()


def test_a_cluster_with_tls_has_the_same_results_and_refuses_others(
    certificates: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert {path.stat().st_mode & 0o777 for path in certificates.iterdir()} == {0o600}
    given = [str(bag_path("ymo")), "--calibration", f"joint1={calibration_path('printed')}"]
    assert main([*given, "--output", str(tmp_path / "alone" / "ymo")]) == 0
    environ = {**LOCAL, "DASK_CONFIG": str(certificates / "dask.yaml")}
    with ExitStack() as stack:
        options = ["--host", "127.0.0.1", "--port", "0", "--protocol", "tls"]
        scheduler = stack.enter_context(Program(part("scheduler", *options), environ))
        address = address_of(scheduler)
        assert address.startswith("tls://127.0.0.1:")
        options = ["--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path / "spill")]
        worker = stack.enter_context(Program(part("worker", address, *options), environ))
        worker.wait_for_line("Registered to:")
        cluster = [*given, "--scheduler", address]
        assert said(capsys, *cluster) == (
            "option --scheduler: there are no certificates for TLS; expected 'distributed.comm.tls' in Dask's "
            "configuration, see docs/how_to/secure_network.md."
        )
        dask.config.refresh(paths=[str(certificates / "dask.yaml")])
        assert main([*cluster, "--output", str(tmp_path / "cluster" / "ymo")]) == 0
        assert contents_of(tmp_path / "cluster") == contents_of(tmp_path / "alone")
        plain = address.replace("tls", "tcp")
        assert said(capsys, *given, "--scheduler", plain) == (
            f"option --scheduler: {plain} is not encrypted; expected tls://, as Dask's configuration says."
        )
        monkeypatch.setattr("posor.bags.executors.CONNECT_WITHIN_S", 1)
        dask.config.set({"distributed.comm.require-encryption": False})
        assert said(capsys, *given, "--scheduler", plain).startswith(
            f"option --scheduler: no Dask scheduler answers at {plain}; "
        )
        subprocess.run([ROOT / "examples/security/make_dask_certificates.sh", tmp_path / "others"], check=True)
        dask.config.refresh(paths=[str(tmp_path / "others" / "dask.yaml")])
        assert said(capsys, *cluster) == (
            f"option --scheduler: the scheduler at {address} and this program do not accept each other's certificates; "
            "expected certificates of one authority, see docs/how_to/secure_network.md."
        )
        (tmp_path / "others" / "client.key").unlink()
        assert said(capsys, *cluster).startswith("option --scheduler: the certificates cannot be used: ")

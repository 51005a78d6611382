# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a node program to the service manager, received by a socket of the test."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from posor.errors import SystemRefusal
from posor_lab.harness.program import TIMEOUT_S, Program, script
from posor_ros.service_manager import ServiceManager

EXAMPLE = script(Path(__file__).with_name("example_node.py"))
WATCHDOG_S = 0.4


@pytest.fixture(params=["file", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """A socket as systemd's, by the name that it has in NOTIFY_SOCKET."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(path if request.param == "file" else f"\0{path}")
        receiver.settimeout(TIMEOUT_S)
        yield receiver, path if request.param == "file" else f"@{path}"


@pytest.mark.usefixtures("ros_domain")
def test_a_program_is_ready_alive_and_stopping(manager: tuple[socket.socket, str]) -> None:
    receiver, name = manager
    with Program(EXAMPLE, {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6))}) as node:
        assert receiver.recv(100) == b"READY=1"
        node.process.send_signal(signal.SIGSTOP)  # it prints no more, and what it has printed may be on its way
        node.wait_for_line("activate")
        node.process.send_signal(signal.SIGCONT)
        assert [receiver.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
        node.process.send_signal(signal.SIGSTOP)
        receiver.settimeout(WATCHDOG_S)
        with suppress(TimeoutError):
            receiver.recv(100)  # one that was sent before
        with pytest.raises(TimeoutError):
            receiver.recv(100)
        receiver.settimeout(TIMEOUT_S)
        node.process.send_signal(signal.SIGCONT)
        assert receiver.recv(100) == b"WATCHDOG=1"
        assert node.end(signal.SIGTERM) == 0
        while (message := receiver.recv(100)) == b"WATCHDOG=1":
            pass
        assert message == b"STOPPING=1"


def test_another_process_sends_the_signs_of_life(manager: tuple[socket.socket, str]) -> None:
    receiver, name = manager
    own = ServiceManager({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"})
    own.report_ready()
    own.report_alive()
    own.close()
    assert [receiver.recv(100) for _ in range(2)] == [b"READY=1", b"STOPPING=1"]


def test_a_missing_socket_is_named(tmp_path: Path) -> None:
    with pytest.raises(SystemRefusal, match=f"NOTIFY_SOCKET {tmp_path}/none: no such file or directory; expected"):
        ServiceManager({"NOTIFY_SOCKET": f"{tmp_path}/none"})


def test_without_a_manager_nothing_is_sent() -> None:
    manager = ServiceManager({})
    manager.report_ready()
    manager.report_alive()
    manager.close()


def test_the_example_of_a_unit_is_valid(tmp_path: Path) -> None:
    verify = shutil.which("systemd-analyze")
    if verify is None:
        pytest.skip("systemd-analyze is not installed")
    root = Path(__file__).resolve().parents[4]
    text = (root / "examples" / "systemd" / "posor.service").read_text(encoding="utf-8")
    assert "Type=notify" in text
    unit = tmp_path / "posor.service"
    unit.write_text(text.replace("/opt/posor", str(root)), encoding="utf-8")
    result = subprocess.run([verify, "verify", str(unit)], check=False, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock of this host by its time service, played by programs of a folder in PATH."""

from __future__ import annotations

import os
import time
from pathlib import Path

import posor_drivers.host_clock
import pytest
from posor_drivers.host_clock import HostClock

CHRONY = "C0A80001,192.168.0.1,2,1795663704.1,0.000001,0.000002,0.000009,-8.1,0.001,0.02,0.000300,0.000100,16.1,{}"
PTP = "sending: GET CURRENT_DATA_SET\n stepsRemoved {}\n offsetFromMaster -120.0\n meanPathDelay 400.0"


@pytest.mark.parametrize(
    ("answers", "limit_s", "words"),
    [
        ({}, 0.0, "no time service"),
        ({"chronyc": CHRONY.format("Normal")}, 2.51e-4, "by chronyc"),
        ({"chronyc": CHRONY.format("Normal").replace("0.000001", "-0.25")}, 0.25025, "by chronyc"),
        ({"chronyc": CHRONY.format("Not synchronised")}, 0.0, "no time service"),
        ({"chronyc": "506 Cannot talk to daemon"}, 0.0, "no time service"),
        ({"chronyc": CHRONY.format("Normal").replace("0.000100", "?")}, 0.0, "no time service"),
        ({"pmc": PTP.format(1), "chronyc": CHRONY.format("Normal")}, 3.2e-7, "by pmc"),
        ({"pmc": PTP.format(0), "chronyc": CHRONY.format("Normal")}, 2.51e-4, "by chronyc"),
    ],
)
def test_the_limit_is_that_of_the_service_that_is_synchronised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answers: dict[str, str], limit_s: float, words: str
) -> None:
    for name, answer in answers.items():
        (tmp_path / name).write_text(f"#!/bin/sh\ncat <<'EOF'\n{answer}\nEOF\n", encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    clock = HostClock()
    assert clock.limit_s == pytest.approx(limit_s, rel=1e-12)
    _, text, values = clock.read()
    assert words in text
    assert values["clock_limit"] == clock.limit_s


def test_a_service_that_takes_its_time_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer, begun, gate = tmp_path / "answer", tmp_path / "begun", tmp_path / "gate"
    answer.write_text(CHRONY.format("Normal"), encoding="utf-8")
    (tmp_path / "chronyc").write_text(f"#!/bin/sh\ncat {answer}\n", encoding="utf-8")
    (tmp_path / "chronyc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    monkeypatch.setattr(posor_drivers.host_clock, "READ_EVERY_S", 0.0)
    monkeypatch.setattr(posor_drivers.host_clock, "TIMEOUT_S", 60.0)
    clock = HostClock()
    os.mkfifo(gate)
    (tmp_path / "chronyc").write_text(f"#!/bin/sh\ntouch {begun}\ncat {gate}\n", encoding="utf-8")
    clock.read()
    while not begun.exists():
        time.sleep(0.01)
    assert clock.read()[2] == {"clock_limit": pytest.approx(2.51e-4)}  # while the service is still asked
    gate.write_text(CHRONY.format("Normal").replace("0.000100", "0.000200"), encoding="utf-8")
    while clock.limit_s == pytest.approx(2.51e-4):
        time.sleep(0.01)
    assert clock.limit_s == pytest.approx(3.51e-4)

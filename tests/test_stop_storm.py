# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that are interrupted at random times from their start on, under load: each ends soon, and cleanly."""

from __future__ import annotations

import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posor_bringup.supervisor import ProgramCommand, Supervisor
from posor_lab.harness.rig_files import bag_path, calibration_path, urdf_path

pytestmark = pytest.mark.usefixtures("ros_domain")

JOINT = "/joint1"
DRIVER = ProgramCommand(
    "driver_node",
    "posor_drivers",
    "driver_node",
    namespace=JOINT,
    parameters={"source": "bag", "bag.path": str(bag_path("ymo")), "loop": True, "restamp": True, "rate": 20.0},
)
POSOR = ProgramCommand(
    "posor_node",
    "posor_estimator",
    "posor_node",
    namespace=JOINT,
    parameters={"calibration": str(calibration_path("printed")), "session": "ymo"},
)
CHAIN = ProgramCommand("chain_node", "posor_estimator", "chain_node", parameters={"urdf": str(urdf_path())})
AT_ONCE = 4  # nodes that start at the same time: more than the host has processors
LATEST_S = 4.0  # latest interruption after the start; under this load a node is active after about half of the time
END_S = 5.0
CODES = {0, 130}  # 130: interrupted before it was active


class Stop:
    """A node that receives one or two interrupts at times drawn at random."""

    def __init__(self, rng: np.random.Generator, supervisor: Supervisor, number: int) -> None:
        program = (DRIVER, POSOR, CHAIN)[rng.integers(3)]
        self.program = supervisor.start(replace(program, name=f"{program.name}_{number}"))
        first_s = time.monotonic() + LATEST_S * rng.random() ** 2
        self.times_s = [first_s] + [first_s + 0.3 * rng.random()] * int(rng.integers(2))
        self.last_s = self.times_s[-1]

    def interrupt_if_due(self) -> None:
        while self.times_s and time.monotonic() >= self.times_s[0]:
            del self.times_s[0]
            self.program.process.send_signal(signal.SIGINT)

    def check_end(self) -> None:
        code = self.program.process.wait(max(0.0, self.last_s + END_S - time.monotonic()))
        output = self.program.log.read_text(encoding="utf-8")
        assert code in CODES, output
        assert "Traceback" not in output


@pytest.mark.parametrize(
    ("seed", "count"), [(1, AT_ONCE), pytest.param(2, 600, marks=[pytest.mark.long, pytest.mark.timeout(3600)])]
)
def test_interrupted_nodes_end_soon_and_cleanly_while_a_driver_publishes(tmp_path: Path, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    with Supervisor(tmp_path) as supervisor:
        driver = supervisor.start(DRIVER)
        for first in range(0, count, AT_ONCE):
            stops = [Stop(rng, supervisor, number) for number in range(first, first + AT_ONCE)]
            while any(stop.times_s for stop in stops):
                for stop in stops:
                    stop.interrupt_if_due()
                time.sleep(1e-3)
            for stop in stops:
                stop.check_end()
        supervisor.end([driver])

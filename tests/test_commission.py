# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor commission on live topics: a robot program does the steps that are announced."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
from posor.messages.message_definitions import MessageTypes
from posor.numerics.array_types import IntArray
from posor.numerics.stamps import NS
from posor.ros_names import JOINT_STATE, RAW_SCAN
from posor_calibration.commissioning.plan import CommissioningSettings, Step
from posor_drivers.message_builder import header, raw_scan, scan_fields
from posor_lab.commissioning.simulated_commissioning import SimulatedCommissioning
from posor_lab.harness.graph import LOSSLESS, Graph
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import CommissioningStep, RawScan
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.usefixtures("ros_domain")
JOINT = "elbow"
SWEEP_S = 12.0
PERIOD_NS = 25_000_000
MOST_ROWS = 3  # of the recording between two scans: 0.25 degrees, a small part of a bump, also where the host is busy


class RobotProgram:
    """Does each step when it is announced, a sweep when it begins: publishes the scans that were simulated there."""

    def __init__(self, sound: SimulatedCommissioning, graph: Graph) -> None:
        self._types, self._tick, self._recording = MessageTypes(), 0, sound.recording
        self._rows, self._begin_ns, self._duration_s = self._rows_of(Step("rest", JOINT)), 0, 1.0
        self._at = 0
        self._raw = {
            j: graph.node.create_publisher(RawScan, f"/five_axis/{j}/raw", LOSSLESS) for j in sound.calibrations
        }
        self._encoders = graph.node.create_publisher(JointState, "/five_axis/encoders", LOSSLESS)
        graph.node.create_subscription(CommissioningStep, "/five_axis/commissioning/step", self._on_step, 10)
        self.steps: list[CommissioningStep] = []

    def _rows_of(self, step: Step) -> IntArray:
        recorded, stamps = self._recording.find(step), self._recording.scans[JOINT].stamps_ns
        assert recorded is not None
        return np.flatnonzero((stamps >= recorded.begin_ns) & (stamps <= recorded.end_ns))

    def _on_step(self, message: CommissioningStep) -> None:
        self.steps.append(message)
        sweeps = message.action == "sweep"
        if message.phase == (CommissioningStep.PHASE_BEGIN if sweeps else CommissioningStep.PHASE_ANNOUNCED):
            self._rows = self._rows_of(Step(message.action, message.joint, message.channel))
            self._begin_ns, self._duration_s, self._at = time.time_ns(), SWEEP_S if sweeps else 1.0, 0
        elif message.phase == CommissioningStep.PHASE_ANNOUNCED:
            self._rows, self._at = self._rows_of(Step("rest", JOINT)), 0

    def publish(self) -> None:
        """Publish a scan of every joint at each tick since the last call: on a busy host late, but without a gap."""
        latest = time.time_ns() // PERIOD_NS
        for tick in range(self._tick + 1 if self._tick else latest, latest + 1):
            self._publish_at(tick)
        self._tick = latest

    def _publish_at(self, tick: int) -> None:
        stamp_ns = tick * PERIOD_NS
        share = max(0, stamp_ns - self._begin_ns) / (NS * self._duration_s)
        self._at = min(int(share * len(self._rows)), self._at + MOST_ROWS, len(self._rows) - 1)
        row = int(self._rows[self._at])
        for joint, publisher in self._raw.items():
            scan = self._recording.scans[joint][row]
            fields = scan_fields(scan) | {"status": 128 * scan.at_home, "scan": tick}
            message = raw_scan(self._types, stamp_ns, f"{joint}_receiving", **fields)
            publisher.publish(self._types.serialize(message, RAW_SCAN))
        names, tracks = list(self._recording.encoders), self._recording.encoders.values()
        position, empty = np.array([track.values[row, 0] for track in tracks]), np.empty(0)
        stamped = header(self._types, stamp_ns, "")
        message = self._types.new(
            JOINT_STATE, header=stamped, name=names, position=position, velocity=empty, effort=empty
        )
        self._encoders.publish(self._types.serialize(message, JOINT_STATE))


def test_a_robot_program_commissions_a_joint_of_a_running_arm(tmp_path: Path) -> None:
    sound = SimulatedCommissioning("five_axis", tmp_path / "arm", 4, CommissioningSettings(sweep=math.radians(10.0)))
    options = ["--joint", JOINT, "--output", str(tmp_path / "out"), "--automatic", "0.3", "--rest-time", "0.4"]
    command = [
        *installed("posor_bringup", "commission"),
        str(sound.arm.path),
        *options,
        "--sweep-time",
        f"{SWEEP_S}",
        "--sweep",
        "10",
    ]
    with Graph() as graph, Program(command) as program:
        robot = RobotProgram(sound, graph)
        while not program.ended:
            robot.publish()
            graph.receive()  # at most 50 ms
        assert program.wait() == 0, [line for line in program.stdout if "FAILED" in line]
    phases = [(step.action, step.channel, step.phase) for step in robot.steps]
    channels = [*(f"gap_{n}" for n in (1, 2, 3)), *(f"ring_{n}" for n in (1, 2, 3, 4))]
    steps = [("rest", ""), *(("lift", channel) for channel in channels), ("sweep", "")]
    assert phases == [(*step, phase) for step in steps for phase in (0, 1, 2)]

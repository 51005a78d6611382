"""Faults that the simulator injects into readings, scans and stamps: one live run for each arm.

The nodes are the real ones; scans and transforms go over DDS. Each fault lasts for ``FAULT_S``. Then the operator
acknowledges it, and the arm has until the next fault to be sound again.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.model.fault import USABLE_STATES, Fault
from posor.numerics.stamps import NS
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.supervisor import ProcessError, Supervisor
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_msgs.msg import RawScan
from posor_ros.message_conversion import stamp_ns

from posor_lab.faults.fault_arm import (
    IMPERFECTION_PARAMETERS,
    IMPERFECTIONS,
    fault_entry,
    quantity,
    write_fault_arm,
)
from posor_lab.faults.fault_receiver import FaultReceiver
from posor_lab.faults.fault_table import ARMS, FaultRow, RowResult
from posor_lab.faults.pose_judge import PoseJudge
from posor_lab.reports.graph_receiver import GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor_lab.faults.fault_table import Arm, FaultKind

FAULT_S, ACKNOWLEDGE_S, SLOT_S = 0.5, 0.7, 2
"""Duration of a fault; time from its beginning to the acknowledgement, and to the next fault."""
SOUND_S = 0.2
"""Time before a fault in which its joint must have poses."""
ATTEMPTS = 3
"""Cycles after which a fault is judged in any case; later ones are for faults that a problem of the host concealed."""
NEEDS_FIRST_SCAN = ("frozen", "frozen_diodes", "stuck")
"""Kinds that repeat the reading at the beginning of the fault, which must have been published."""
SETTLING_TIMEOUT_S = 90.0
"""Longest time from the start of the nodes until the arm has poses."""
SETTLED_POSES = 20
"""Endpoint poses without interruption before a run counts."""
HOUR_S = 3601.3
"""Shift of a clock; no multiple of a cycle, after which the motion repeats."""


class ScenarioFault(NamedTuple):
    """A row and the entry of the scenario file that injects it."""

    row: FaultRow
    kind: str
    entries: Mapping[str, Any]


def _rows() -> list[ScenarioFault]:
    rows: list[ScenarioFault] = []

    def add(arm: Arm, name: str, kind: FaultKind, injected: str, expected: str, *named_by: str, **entries: Any) -> None:
        rows.append(ScenarioFault(FaultRow(name, kind, arm, expected, named_by), injected, entries))

    lost, jump = "LOST, RESIDUAL, and latched", "LOST, by residual, range or jump, and latched"
    contradiction = ("RESIDUAL", "OUT_OF_RANGE", "INNOVATION", "BAD_READING", "FROZEN", "SOURCE", "DARK_DIODE")
    volts, amperes = {"channel": "gap_1"}, {"channel": "diode_1", "contact": "A"}
    arm: Arm = "six_axis"
    for offset, text in ((0.05, "+50 mV"), (0.1, "+100 mV"), (1.0, "+1 V")):
        add(arm, f"gap probe {text}", "wrong", "offset", lost, *contradiction, **volts, size=quantity(offset, "V"))
    add(arm, "gap probe stuck at 0 V", "stuck", "value", lost, *contradiction, **volts, size=quantity(0.0, "V"))
    add(arm, "gap probe stuck at a reading", "stuck", "stuck", "LOST, FROZEN or RESIDUAL", *contradiction, **volts)
    add(arm, "gap probe garbage", "garbage", "garbage", lost, *contradiction, **volts, size=quantity(5.0, "V"))
    add(arm, "gap probe not a number", "garbage", "nan", "LOST, BAD_READING", "BAD_READING", **volts)
    add(arm, "diode dark", "off", "dark", "LOST, DARK_DIODE", "DARK_DIODE", channel="diode_1")
    add(arm, "diode stuck", "stuck", "stuck", "LOST, FROZEN or RESIDUAL", *contradiction, channel="diode_1")
    add(arm, "all diodes frozen while the probes go on", "stuck", "frozen_diodes", "LOST, FROZEN", "FROZEN")
    garbage = quantity(1e-4, "A")
    add(arm, "diode garbage", "garbage", "garbage", jump, *contradiction, channel="diode_1", size=garbage)
    add(arm, "diode contact +5 uA", "wrong", "offset", jump, *contradiction, **amperes, size=quantity(5e-6, "A"))
    add(arm, "diode contact not a number", "garbage", "nan", "LOST, BAD_READING", "BAD_READING", **amperes)
    for count in (1, 2, 11):
        add(
            arm,
            f"light-source index off by {count} on both diodes",
            "wrong",
            "slip",
            "LOST, by the distance of the spots, and latched",
            *contradiction,
            size=quantity(count, "1"),
        )
    for name in ARMS:
        add(name, "all readings frozen", "stuck", "frozen", "LOST, FROZEN", "FROZEN", "INNOVATION", "RESIDUAL")
        for supply in (16.0, 0.0):
            add(
                name,
                f"supply {supply:g} V",
                "wrong",
                "supply",
                "LOST, ENVIRONMENT",
                "ENVIRONMENT",
                size=quantity(supply, "V"),
            )
        add(name, "no scans", "off", "off", "STALE within 0.5 s, names the topic", "no input", "missing")
    for kelvin, text in ((313.0, "temperature 313 K"), (20.0, "temperature 20 (Celsius)")):
        add(arm, text, "wrong", "temperature", "LOST, ENVIRONMENT", "ENVIRONMENT", size=quantity(kelvin, "K"))
    for flag, text in (
        (RawScan.STATUS_SATURATED, "SATURATED"),
        (RawScan.STATUS_PROBES_ESTIMATED, "PROBES_ESTIMATED"),
        (RawScan.STATUS_DIODES_ESTIMATED, "DIODES_ESTIMATED"),
    ):
        add(arm, f"driver flag {text}", "wrong", "status", "DEGRADED, FLAGGED", "FLAGGED", size=quantity(flag, "1"))
    late = quantity(0.6, "s")
    add(arm, "scans 0.6 s late", "slow", "late", "STALE, names the topic", "no input", "missing", size=late)
    for sign, text in ((1, "ahead"), (-1, "old")):
        size = quantity(sign * HOUR_S, "s")
        add(
            arm,
            f"stamps 1 h {text}",
            "clock",
            "clock",
            "LOST, names the stamp's age",
            "stamp",
            "BAD_READING",
            size=size,
        )
    add(arm, "scan numbers missing", "clock", "number", "counted and named", "missing before", size=quantity(7, "1"))
    add(arm, "scan numbers backward", "clock", "number", "counted and named", "came after", size=quantity(-7, "1"))
    add(arm, "scans repeated", "clock", "repeat", "counted and named, not used again", "repeated", "FROZEN")
    arm = "five_axis"
    ring = {"channel": "ring_1"}
    add(arm, "ring probe +1 V", "wrong", "offset", jump, *contradiction, "COUNT", **ring, size=quantity(1.0, "V"))
    add(arm, "ring probe stuck", "stuck", "stuck", "LOST, FROZEN or RESIDUAL", *contradiction, "COUNT", **ring)
    home = "COUNT fault once theta is counted; no re-index"
    add(arm, "spurious HOME flags", "wrong", "home", home, "COUNT")
    garbage = quantity(5.0, "V")
    add(arm, "ring probe garbage", "garbage", "garbage", jump, *contradiction, "COUNT", **ring, size=garbage)
    add(arm, "ring probe not a number", "garbage", "nan", "LOST, BAD_READING", "BAD_READING", **ring)
    for name in ARMS[1:]:
        add(name, "gap probe +1 V", "wrong", "offset", jump, *contradiction, **volts, size=quantity(1.0, "V"))
        # Only the motion gate checks three gap probes, and some of the voltages lie within it.
        row = FaultRow(
            "gap probe garbage",
            "garbage",
            name,
            f"{jump}; else within the protection level",
            contradiction,
            may_hide=True,
        )
        rows.append(ScenarioFault(row, "garbage", {**volts, "size": garbage}))
        add(name, "gap probe stuck at a reading", "stuck", "stuck", "LOST, FROZEN", "FROZEN", **volts)
    arm = "test_rig"
    add(arm, "gap probe stuck at 0 V", "stuck", "value", jump, *contradiction, **volts, size=quantity(0.0, "V"))
    add(arm, "diode dark", "off", "dark", "LOST, DARK_DIODE", "DARK_DIODE", channel="diode_1")
    add(arm, "diode contact +5 uA", "wrong", "offset", jump, *contradiction, **amperes, size=quantity(5e-6, "A"))
    add(arm, "wrong light source lit", "wrong", "slip", "LOST, SOURCE", *contradiction, size=quantity(1, "1"))
    return rows


SCENARIO_FAULTS = tuple(_rows())


class ReadingRun:
    """A live run of one arm with its faults, one after the other."""

    def __init__(
        self, arm: Arm, faults: Sequence[ScenarioFault], folder: Path, seed: int, interrupted: Callable[[], bool]
    ) -> None:
        """Write the arm; nothing is started yet.

        Args:
            arm: Installed arm.
            faults: Its faults.
            folder: Existing folder for the copy of the arm and the logs.
            seed: Of motion, noise and faults.
            interrupted: Whether the user has interrupted the run.

        """
        self._faults, self._folder, self._interrupted = faults, folder, interrupted
        duration_s = max(SLOT_S * len(faults), 2 * SLOT_S)
        path = folder / arm
        joints = list(write_fault_arm(arm, folder / "sound", duration_s, seed).calibrations)
        self._joints = [joints[n % len(joints)] for n in range(len(faults))]
        entries = [
            fault_entry(joint, fault.kind, SLOT_S * n + SOUND_S, SLOT_S * n + SOUND_S + FAULT_S, **fault.entries)
            for n, (joint, fault) in enumerate(zip(self._joints, faults, strict=True))
        ]
        self._arm = write_fault_arm(arm, path, duration_s, seed, entries)
        self._simulation = ArmSimulation(self._arm, IMPERFECTIONS)
        self._judge_of_poses = PoseJudge(self._simulation)
        self._cycle_ns = duration_s * NS

    def run(self) -> list[RowResult]:
        """Run the nodes until each fault has occurred; return the results.

        Raises:
            ProcessError: A node failed, or the arm has no poses.

        """
        self._started_s = self._acknowledged_s = time.monotonic()
        programs = arm_programs(self._arm, driver_parameters=IMPERFECTION_PARAMETERS)
        joints = self._simulation.joints
        with Supervisor(self._folder) as supervisor, FaultReceiver(self._arm.name, joints) as receiver:
            for program in group_programs(programs, "drivers_apart", self._folder):
                supervisor.start(program)
            watch = GraphWatch(supervisor, receiver, "faults", interrupted=self._interrupted)
            watch.wait(partial(self._is_settled, receiver), lambda: "endpoint poses")
            results: dict[int, RowResult] = {}
            for _ in range(ATTEMPTS):
                begins = self._receive_faults(receiver, watch)
                pending = [n for n in begins if n not in results or results[n].problem]
                results |= {n: self._judge(receiver, n, begins[n]) for n in pending}
                if not any(result.problem for result in results.values()):
                    break
            return [results[n] for n in sorted(results)]

    def _is_settled(self, receiver: FaultReceiver) -> bool:
        """Return whether the arm has poses; acknowledge latched faults, which occur before the run begins to count."""
        now_s = time.monotonic()
        if now_s - self._started_s > SETTLING_TIMEOUT_S:
            raise ProcessError(f"no endpoint poses in {SETTLING_TIMEOUT_S:g} s", where=self._arm.name)
        if now_s > self._acknowledged_s + ACKNOWLEDGE_S:
            self._acknowledged_s = now_s
            for joint in self._simulation.joints:
                newest = receiver.newest(f"{joint}/{TRANSFORM_TOPIC}")
                if newest is not None and newest.message.faults & Fault.LATCHED:
                    receiver.acknowledge(joint)
        return receiver.usable_endpoints(SETTLED_POSES)

    def _receive_faults(self, receiver: FaultReceiver, watch: GraphWatch) -> dict[int, int]:
        """Receive until each fault has occurred, and acknowledge each; return when each began [ns]."""
        now_ns = time.time_ns()
        begins = {}
        for n in range(len(self._faults)):
            offset_ns = round((SLOT_S * n + SOUND_S) * NS)
            cycles = -((offset_ns - now_ns - NS) // self._cycle_ns)
            begins[n] = cycles * self._cycle_ns + offset_ns
        pending = sorted((begin_ns + round(ACKNOWLEDGE_S * NS), n) for n, begin_ns in begins.items())
        for due_ns, n in pending:
            watch.wait(lambda due_ns=due_ns: time.time_ns() >= due_ns, lambda: "time")  # type: ignore[misc]
            receiver.acknowledge(self._joints[n])
        receiver.receive_for(SLOT_S - ACKNOWLEDGE_S - SOUND_S)
        return begins

    def _judge(self, receiver: FaultReceiver, n: int, begin_ns: int) -> RowResult:
        """Return what was published about fault n, which began at a time [ns]."""
        row, joint = self._faults[n].row, self._joints[n]
        end_ns = begin_ns + round((SLOT_S - SOUND_S) * NS)
        topic = f"{joint}/{TRANSFORM_TOPIC}"
        before = receiver.between(topic, begin_ns - round(SOUND_S * NS), begin_ns)
        stamps = {stamp_ns(each.message) for each in receiver.between(topic, begin_ns, end_ns)}
        problem = ""
        if not any(each.message.state in USABLE_STATES for each in before):
            problem = "its joint had no pose before the fault"
        elif self._faults[n].kind in NEEDS_FIRST_SCAN and begin_ns not in stamps:
            problem = "the driver missed the scan at which the fault began: the host is overloaded"
        named_ns = receiver.first_naming_ns(row.named_by, begin_ns, end_ns, joint)
        during = [stamp for stamp in stamps if begin_ns <= stamp < begin_ns + round(FAULT_S * NS)]
        faulted_ns = min(during, default=begin_ns)  # a late driver leaves out the first scans
        return RowResult(
            row,
            receiver.describe(begin_ns, begin_ns + round(FAULT_S * NS), joint),
            None if named_ns is None else max(0.0, (named_ns - faulted_ns) / NS),
            self._judge_of_poses.count_wrong(receiver, begin_ns, end_ns, joint),
            covered=math.nan if row.is_observable else self._judge_of_poses.covered_share(receiver, begin_ns, end_ns),
            problem=problem,
        )

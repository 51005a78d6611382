# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows of the fault table, which ``fault_table.yaml`` lists, their results, and the arms whose scenario has faults."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import yaml
from posor.arm_names import ARM_FILE, find_arm
from posor.calibration.calibration_file import load_calibration
from posor.calibration.designs import design
from posor.chain.arm_file import ArmFile, load_arm_file
from posor_drivers.simulator.imperfections import Imperfections

from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


RATES: Mapping[str, int] = {"six_axis": 50, "five_axis": 50, "test_rig": 100, "quad_rig": 100, "five_axis_checked": 50}
"""Scans per second: drivers, nodes and the receiver of the trial share two processors with other work."""
AMPLITUDES: Mapping[str, float] = {
    "six_axis": 0.03,
    "five_axis": 0.06,
    "test_rig": 0.03,
    "quad_rig": 0.03,
    "five_axis_checked": 0.06,
}
"""Of the motion about home [rad]: bumpy rings move by more than a bump and pass their home marks once a second."""
CYCLE_S = 20  # usual duration of the scenario's cycle
WAYPOINT_S = 1.0  # usual time between two waypoints of the motion
REST_S = 0.5  # duration of a rest between two parts of the motion
STACKS: Mapping[str, str] = {"quad_rig": "test_rig"}
"""Arms whose joints get four gap probes and fixed diodes, and the installed arm that is copied."""
IMPERFECTIONS = Imperfections(dropouts=False, zero_drift=False)
"""Zero drift is not part of the stated covariance, and dropouts are faults themselves."""
IMPERFECTION_PARAMETERS = {f"simulated.{name}": getattr(IMPERFECTIONS, name) for name in ("dropouts", "zero_drift")}
"""The imperfections as parameters of the drivers."""


def fault_entry(joint: str, entries: Mapping[str, Any], begin_s: float, end_s: float) -> dict[str, Any]:
    """Return an entry of ``faults`` of a scenario file."""
    return {"joint": joint, "from": quantity(begin_s, "s"), "until": quantity(end_s, "s"), **entries}


def write_fault_arm(
    name: str,
    folder: Path,
    duration_s: int,
    seed: int,
    faults: Sequence[dict[str, Any]] = (),
    waypoint_s: float = WAYPOINT_S,
    amplitude: float = 0.0,
    rests: int = 0,
    rate: int = 0,
) -> ArmFile:
    """Write a copy of an installed arm into a new folder and return it.

    Its scenario has a cycle of ``duration_s``, a motion that changes its direction every ``waypoint_s``, and
    ``faults``. ``amplitude``: of the motion [rad]; 0: the usual one. ``rests``: how often it rests for REST_S.
    ``rate``: scans per second; 0: the usual ones.
    """
    shutil.copytree(find_arm(STACKS.get(name, name)).parent, folder)
    _allow_releases(folder / ARM_FILE)
    arm = load_arm_file(folder / ARM_FILE)
    joints = list(arm.calibrations)
    if name in STACKS:
        for path in arm.calibrations.values():
            frames = load_calibration(path).frames
            stack = design("quad_diodes", motion=True, converter=True, frames=(frames.parent, frames.child))
            path.write_text(yaml.safe_dump(stack.model_dump(mode="json", exclude_defaults=True)), encoding="utf-8")
    parts = max(1, rests)
    part_s = duration_s / parts - (REST_S if rests else 0.0)
    count = round(part_s / waypoint_s)
    signs = np.where(np.arange(parts * count) % 2, 1.0, -1.0)[:, None]
    waypoints = signs * np.random.default_rng(seed).uniform(0.5, 1.0, (parts * count, len(joints)))
    waypoints *= amplitude or AMPLITUDES[name]
    waypoints[count - 1 :: count] = 0.0
    path = folder / "scenario.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    motion = []
    for through in np.split(waypoints, parts):
        spline = {"kind": "spline", "duration": quantity(part_s, "s"), "joints": joints}
        motion += [{"kind": "rest", "duration": quantity(REST_S, "s")}] if rests else []
        motion.append({**spline, "through": quantity(through.tolist(), "rad")})
    content |= {
        "seed": seed,
        "rate": quantity(rate or RATES[name], "Hz"),
        "duration": quantity(duration_s, "s"),
        "motion": motion,
        "faults": list(faults),
        "truth": "independent",
    }
    for joint in content["joints"].values():
        joint.pop("start", None)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return arm


def _allow_releases(path: Path) -> None:
    """Let the program release latches as often as its faults come."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    for joint in content["joints"].values():
        joint["parameters"] = {**joint.get("parameters", {}), "acknowledge_interval": 0.0}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


FaultKind = Literal["off", "stuck", "garbage", "wrong", "slow", "clock", "network"]
"""Failure types of PX4's fault injection, and faults of clock and network."""
ArmName = Literal["six_axis", "five_axis", "five_axis_checked", "test_rig", "quad_rig"]
"""Installed arms: light rings and four gap probes; bumpy rings and three; fixed diodes and three; and with four."""
ARMS: tuple[ArmName, ...] = get_args(ArmName)
TIME_RUNS = ("times", "stamps", "offline_times")
"""Sections whose faults cost scans, but never a wrong pose."""
COVERED_SHARE = 0.99  # least share of cases in which the protection level covers a fault that is not observable


@dataclass(frozen=True)
class FaultRow:
    """One fault of the table; ``fault_table.yaml`` explains the fields."""

    name: str
    kind: FaultKind
    arm: ArmName | Literal["any stack"]
    expected: str
    named_by: tuple[str, ...] = ()
    may_hide: bool = False
    quick: bool = False
    most_lost: int | None = None  # most scans without a pose while the fault lasts; None: not judged
    least_usable: float | None = None  # least share of scans with a pose while the fault lasts; None: not judged
    # Of faults of time without nodes: whether the joint must have a pose at the end, and whether a count of theta may
    # be given up until the next home mark
    recovers: bool = True
    uncounts: bool = False
    run: str = ""  # section of the table: the run that injects the fault
    inject: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name of the arm and of the fault; unique in the table."""
        return f"{self.arm}: {self.name}"

    @property
    def is_observable(self) -> bool:
        """Whether no pose may be wrong, as each scan with the fault shows it; else the protection level covers it."""
        return bool(self.named_by or self.run in TIME_RUNS) and not self.may_hide


def _load_table() -> tuple[Mapping[FaultKind, float], tuple[FaultRow, ...]]:
    content = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    limits, groups = content.pop("limits_s"), content.pop("groups")
    rows = []
    for run, of_run in content.items():
        for row in of_run:
            words = [word for name in row.pop("named_by", ()) for word in groups.get(name, [name])]
            arms = row.pop("arms", None) or [row.pop("arm")]
            rows += [FaultRow(run=run, arm=arm, named_by=tuple(words), **row) for arm in arms]
    return limits, tuple(rows)


NAMING_LIMITS_S, FAULT_TABLE = _load_table()


@dataclass(frozen=True)
class RowResult:
    """Result of a run for one fault."""

    row: FaultRow
    seen: str  # sentence on the published messages
    naming_s: float | None  # time from the fault to the first message that names it [s]; None: not named
    wrong_ok: int  # poses published as valid that are beyond 5 standard deviations of the truth
    covered: float = math.nan  # share of cases within the protection level, of a fault that is not observable
    lost: int = 0  # scans of the joint that have no pose while the fault lasts, of faults of time
    scans: int = 0  # scans that came meanwhile
    problem: str = ""  # why the run does not count, such as a joint without a pose before the fault; empty: it counts

    @property
    def failures(self) -> list[str]:
        """Sentences on the aims that are missed; empty: the row holds."""
        found = [self.problem] if self.problem else []
        if not self.row.is_observable:
            if not self.covered >= (1.0 if self.row.run == "causes" else COVERED_SHARE):
                found.append(f"the protection level covers {100.0 * self.covered:.1f} % of the cases")
        elif self.wrong_ok:
            found.append(f"{self.wrong_ok} wrong poses published as valid")
        most, least = self.row.most_lost, self.row.least_usable
        if most is not None and self.lost > most:
            found.append(f"{self.lost} scans lost, limit {most}")
        if least is not None and not self.scans - self.lost >= least * self.scans > 0.0:
            found.append(f"{self.scans - self.lost} of {self.scans} scans have a pose, limit {100.0 * least:g} %")
        limit = NAMING_LIMITS_S[self.row.kind]
        if self.row.named_by and self.naming_s is None:
            found.append("not named")
        elif self.row.named_by and self.naming_s is not None and self.naming_s > limit:
            found.append(f"named after {self.naming_s:.2f} s, limit {limit:g} s")
        return found

    def as_json(self) -> dict[str, Any]:
        """Return the row of ``faults.json``."""
        return {
            "fault": self.row.title,
            "kind": self.row.kind,
            "observable": self.row.is_observable,
            "expected": self.row.expected,
            "seen": self.seen,
            "naming_s": None if self.naming_s is None else round(self.naming_s, 4),
            "wrong_ok": self.wrong_ok,
            "lost": self.lost,
            "covered": None if math.isnan(self.covered) else round(self.covered, 4),
            "failures": self.failures,
        }

"""Writes a copy of an installed arm whose scenario moves steadily and has faults one after the other."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from posor.chain.arm_file import load_arm_file
from posor_bringup.arms import ARM_FILE, find_arm
from posor_drivers.simulator.imperfections import Imperfections

from posor_lab.instruments.simulated_readings import quantity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

    from posor_lab.faults.fault_table import Arm

RATES: Mapping[Arm, int] = {"six_axis": 50, "five_axis": 50, "test_rig": 100}
"""Scans per second that two processors can follow with all drivers and nodes."""
AMPLITUDES: Mapping[Arm, float] = {"six_axis": 0.03, "five_axis": 0.06, "test_rig": 0.03}
"""Of the motion about home [rad]: bumpy rings move by more than a bump and pass their home marks once a second."""
CYCLE_S = 20
"""Usual duration of the scenario's cycle."""
WAYPOINT_S = 1.0
"""Usual time between two waypoints of the motion."""
IMPERFECTIONS = Imperfections(dropouts=False, zero_drift=False)
"""Zero drift is not part of the stated covariance, and dropouts are faults themselves."""
IMPERFECTION_PARAMETERS = {f"simulated.{name}": getattr(IMPERFECTIONS, name) for name in ("dropouts", "zero_drift")}
"""The imperfections as parameters of the drivers."""


def fault_entry(joint: str, entries: Mapping[str, Any], begin_s: float, end_s: float) -> dict[str, Any]:
    """Return an entry of ``faults`` of a scenario file."""
    return {"joint": joint, "from": quantity(begin_s, "s"), "until": quantity(end_s, "s"), **entries}


def write_fault_arm(
    name: Arm,
    folder: Path,
    duration_s: int,
    seed: int,
    faults: Sequence[dict[str, Any]] = (),
    waypoint_s: float = WAYPOINT_S,
) -> ArmFile:
    """Write the arm and return it.

    Args:
        name: Installed arm.
        folder: New folder.
        duration_s: Duration of the scenario's cycle.
        seed: Of the motion and of all noise.
        faults: Section ``faults`` of the scenario.
        waypoint_s: Time between two waypoints of the motion, which changes its direction there.

    """
    shutil.copytree(find_arm(name).parent, folder)
    arm = load_arm_file(folder / ARM_FILE)
    joints = list(arm.calibrations)
    count = round(duration_s / waypoint_s)
    signs = np.where(np.arange(count) % 2, 1.0, -1.0)[:, None]
    waypoints = AMPLITUDES[name] * signs * np.random.default_rng(seed).uniform(0.5, 1.0, (count, len(joints)))
    waypoints[-1] = 0.0
    path = folder / "scenario.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    spline = {"kind": "spline", "duration": quantity(duration_s, "s"), "joints": joints}
    content |= {
        "seed": seed,
        "rate": quantity(RATES[name], "Hz"),
        "duration": quantity(duration_s, "s"),
        "motion": [{**spline, "through": {"value": waypoints.tolist(), "unit": "rad"}}],
        "faults": list(faults),
    }
    for joint in content["joints"].values():
        joint.pop("start", None)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return arm

"""Rows of the thesis table for the loads of the conceptual robot's joints and its weight, section 9.4."""

from __future__ import annotations

import math
from typing import Any

from posor_design.joint_loads import bearing_pair, chain_drive, gear_drive, joint_moment
from posor_design.structures import cantilever_beam, cantilever_for_stress
from posor_design.torsion import shaft_stress
from scipy.constants import degree, inch, lbf, psi

from posor_lab.thesis_table.printed_units import POUND_INCH
from posor_lab.thesis_table.thesis_row import ThesisRow

ALUMINIUM_MODULUS = 10e6 * psi
"""Of 6.2.3."""
DESIGN_STRESS = 5000.0 * psi
GRIP = 16.0 * inch
"""From the wrist yaw joint to the centre of the grip, 9.4.1."""


def joint_load_rows() -> list[ThesisRow]:
    """Return the rows of 9.4."""
    return [*_wrist_rows(), *_arm_rows(), *_weight_rows()]


def _moment(*loads: tuple[float, float]) -> float:
    """Return the moment [in lbf] of loads, each a distance [in] and a force [lbf]."""
    distances, forces = zip(*loads, strict=True)
    found = joint_moment(tuple(each * inch for each in distances), tuple(each * lbf for each in forces))
    return found.moment / POUND_INCH


def _wrist_rows() -> list[ThesisRow]:
    yaw = joint_moment((GRIP,), (200.0 * lbf,))
    chain = chain_drive(yaw.moment, 4.0 * inch, piston_area=inch**2, stroke=8.0 * inch)
    roll = _moment((16.0, 200.0))
    drive = gear_drive(roll * POUND_INCH, 1.0 * inch, 5.0 * inch)
    half, full = (shaft_stress(drive.pinion_torque, diameter).stress / psi for diameter in (0.5 * inch, 1.0 * inch))
    return [
        ThesisRow(
            "9.4.1", "radial load of each bearing", "lb", "640", bearing_pair(yaw.moment, 5.0 * inch).radial_force / lbf
        ),
        ThesisRow("9.4.1", "thrust load", "lb", "200", yaw.force / lbf),
        ThesisRow(
            "9.4.1",
            "yaw to each side, stroke 8 in on a sprocket of 4 in",
            "deg",
            "120",
            0.5 * chain.travel / degree,
            f"120 deg need a stroke of {120.0 * degree * 4.0:.2f} in",
        ),
        ThesisRow("9.4.2", "moment at the wrist roll joint", "in lbf", "5650", _moment((26.0, 200.0), (9.0, 50.0))),
        ThesisRow("9.4.2", "largest roll moment", "in lbf", "3200", roll),
        ThesisRow(
            "9.4.2",
            "torque of the drive shaft",
            "in lbf",
            "640",
            drive.pinion_torque / POUND_INCH,
            "not independent: the pinion is not printed, and 1 in is the one that fits this number with the printed "
            "gear of 5 in",
        ),
        ThesisRow(
            "9.4.2",
            "stress of the drive shaft",
            "ksi",
            "20",
            half / 1e3,
            f"the diameter is printed as 1 in and as 12.7 mm, here 12.7 mm; 1 in makes {full / 1e3:.1f} ksi",
        ),
    ]


def _arm_rows() -> list[ThesisRow]:
    elbow = _moment((39.0, 50.0), (30.0, 30.0), (46.0, 200.0), (15.0, 10.0))
    shoulder = _moment((68.0, 50.0), (60.0, 30.0), (76.0, 200.0), (45.0, 10.0), (30.0, 150.0), (15.0, 15.0))
    elbow_drive, shoulder_drive = (
        gear_drive(moment * POUND_INCH, 3.5 * inch, gear * inch) for moment, gear in ((elbow, 10.5), (shoulder, 22.4))
    )
    needed = cantilever_for_stress(**_as_tip_force(shoulder), height=5.0 * inch, width=5.0 * inch, stress=DESIGN_STRESS)
    return [
        ThesisRow("9.4.3", "major moment at the elbow", "in lbf", "12200", elbow),
        ThesisRow(
            "9.4.3",
            "minor moment at the elbow",
            "in lbf",
            "6300",
            _moment((21.0, 300.0)),
            "not independent: the scan has 211 for the distance, and 21 in is the one that fits this number",
        ),
        ThesisRow("9.4.3", "stress of the box 4 x 4 x 1/8 in", "psi", "5000", _box_stress(elbow, 4.0)),
        ThesisRow("9.4.3", "gear ratio of the elbow", "1", "3", elbow_drive.ratio),
        ThesisRow("9.4.4", "major moment at the shoulder", "in lbf", "25575", shoulder),
        ThesisRow("9.4.4", "minor moment at the shoulder", "in lbf", "10000", _moment((25.0, 400.0))),
        ThesisRow(
            "9.4.4",
            "stress of the box 5 x 5 x 1/8 in",
            "psi",
            "5000",
            _box_stress(shoulder, 5.0),
            f"does not follow from the printed moment and section; 5000 psi need a wall of {needed.wall / inch:.3f} in",
        ),
        ThesisRow("9.4.4", "gear ratio of the shoulder", "1", "6.4", shoulder_drive.ratio),
    ]


def _as_tip_force(moment: float) -> dict[str, Any]:
    """Return the arguments of an aluminium cantilever whose moment [in lbf] at the clamp is that of a tip force."""
    return {"length": inch, "tip_force": moment * lbf, "modulus": ALUMINIUM_MODULUS}


def _box_stress(moment: float, side: float) -> float:
    """Return the stress [psi] of a square box with a wall of 1/8 in, by a moment [in lbf]."""
    box = cantilever_beam(**_as_tip_force(moment), height=side * inch, width=side * inch, wall=0.125 * inch)
    return box.stress / psi


def _weight_rows() -> list[ThesisRow]:
    weight = math.fsum((325.0, 175.0, 300.0))
    motors = math.fsum((40.0, 57.0, 68.0, 68.0))
    return [
        ThesisRow("9.4.5", "weight of the robot: bearings, motors, structure", "lb", "800", weight),
        ThesisRow("9.4.5", "weight over payload of 200 lb", "1", "4", weight / 200.0),
        ThesisRow(
            "9.4.5",
            "weight of the motors of 9.4.2 to 9.4.4",
            "lb",
            "175",
            motors,
            "40, 57 and two of 68 lb (9.4.4: shoulder and base swivel have the same motor); with one of 68 lb: 165 lb",
        ),
    ]

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A statement as the content of a Digital Calibration Certificate."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pinocchio as pin
from posor.certificates.dcc_document import Block, Certificate, HashedFile, Quantity

from posor_design.arm_uncertainty import COVERAGE
from posor_design.reliability_report import AXES

if TYPE_CHECKING:
    from posor_design.statement import Statement

UNITS = ("m",) * 3 + ("rad",) * 3
NORMS = ("JCGM 100:2008", "JCGM 102:2011")


def certificate_of(statement: Statement) -> Certificate:
    """Return the content of a certificate.

    The orientation is stated as a quaternion without uncertainty, and its deviation about each axis as 0 with an
    expanded uncertainty: that of roll, pitch and yaw would be another one.
    """
    worst, base = statement.worst, statement.base_frame
    position, quaternion = worst.T_base_endpoint.translation.tolist(), pin.SE3ToXYZQUAT(worst.T_base_endpoint)[3:]
    stated = [
        Quantity(
            f"{axis} of the endpoint in {base}" if unit == "m" else f"deviation of the orientation {axis} of {base}",
            position[n] if unit == "m" else 0.0,
            unit,
            float(worst.expanded[n]),
            float(worst.factors[n]),
            COVERAGE,
            "normal" if math.isinf(worst.freedoms[n]) else f"t, {worst.freedoms[n]:.6g} degrees of freedom",
        )
        for n, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True))
    ]
    levels = [
        Quantity(f"protection level, {axis}", float(level), unit)
        for axis, unit, level in zip(AXES, UNITS, statement.reliability.protection_level, strict=True)
    ]
    turn = [Quantity(f"quaternion {name}", float(q), "1") for name, q in zip("xyzw", quaternion, strict=True)]
    largest = Quantity("largest expanded uncertainty of the position along any direction", worst.largest, "m")
    angles = [Quantity(f"angle of {joint}", angle, "rad") for joint, angle in worst.angles.items()]
    pose = Block(f"joint angles of the pose: {statement.name}", angles)
    others = [Block(each.name, (), [each.text]) for each in statement.conditions if each.name != "joint angles"]
    return Certificate(
        title=f"Endpoint of {statement.arm.name}",
        item=f"measuring arm {statement.arm.name}",
        identifications={"serial number": statement.arm.serial, "identity (SHA-256 of its files)": statement.identity},
        software=(statement.software.split()[0], statement.software.split()[1]),
        method="Uncertainty of the endpoint of an arm of POSORs",
        norms=NORMS,
        files=[HashedFile(each.role, each.path.name, each.sha256) for each in statement.records.all.values()],
        conditions=[pose, *others],
        results=[
            Block("position and deviation of the orientation", stated),
            Block(f"orientation of {statement.arm.endpoint_frame} in {base}", turn),
            Block("position along any direction", [largest]),
            Block("protection level: bound of the error after an undetected fault", levels),
        ],
        declarations={
            "expanded uncertainty": statement.sentences(),
            "not in the numbers": list(statement.reservations),
        },
    )

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files of an allotment: a requirement for each POSOR, the beams, and with designed POSORs the whole arm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np
from posor.arm_names import ARM_FILE
from posor.calibration.document_text import document_text
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import read_text
from posor.chain.beams_file import VERSION as BEAMS_VERSION
from posor.chain.beams_file import load_beams
from posor.errors import ChainError
from posor.uncertainty.budget_quantities import NATIVE

from posor_design.arm_allotment import beams_with
from posor_design.posor_output import SCENARIO, arm_text, made_by
from posor_design.reliability_report import AXES
from posor_design.requirement import Requirement, requirement_content

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray

    from posor_design.arm_allotment import Allotment
    from posor_design.layout_evaluation import Candidate

PROGRAM = "posor design arm"
BEAMS = "beams.yaml"


def joint_requirements(arm: ArmFile, allotment: Allotment) -> dict[str, Requirement]:
    """Return the requirement of each joint's POSOR: its allotment, the size of its plate, and assumed ranges.

    Raises ChainError: the URDF draws no receiving plate as a cylinder, so that no outside diameter is known.
    """
    chain = arm.chain()
    sigmas = _by_part(allotment, beam=False)
    requirements = {}
    for joint in chain.joints:
        own = sigmas[joint.name]
        limits = {name: own["translations" if unit == "m" else "angles"] for name, unit in NATIVE}
        diameter = _plate_diameter(chain.urdf, joint.parent, str(arm.urdf))
        content = requirement_content(joint.name, limits, 1.0, {"outside_diameter": diameter})
        requirements[joint.name] = Requirement.model_validate(content)
    return requirements


def _plate_diameter(urdf: str, link: str, source: str) -> float:
    for cylinder in ET.fromstring(urdf).findall(f"link[@name='{link}']/visual/geometry/cylinder"):  # noqa: S314  own file
        return 2.0 * float(cylinder.get("radius", "nan"))
    raise ChainError(f"link '{link}' has no cylinder in its visual", where=source, expected="the receiving plate")


def allotted_beams(arm: ArmFile, allotment: Allotment) -> str | None:
    """Return the beams file with the allotted uncertainties; None: the arm has none."""
    if arm.beams is None:
        return None
    variances = {
        name: np.square([*(own["translations"],) * 3, *(own["angles"],) * 3])
        for name, own in _by_part(allotment, beam=True).items()
    }
    content = allotment.errors.beams_with(beams_with(load_beams(arm.beams), variances)).model_dump(mode="json")
    content["version"] = BEAMS_VERSION
    content["provenance"]["notes"] = [*content["provenance"]["notes"], "uncertainties allotted by posor design arm"]
    return document_text(content, made_by(PROGRAM))


def _by_part(allotment: Allotment, *, beam: bool) -> dict[str, dict[str, float]]:
    parts: dict[str, dict[str, float]] = {}
    for group, sigma in zip(allotment.groups, allotment.allotted, strict=True):
        if group.beam == beam:
            parts.setdefault(group.part, {})[group.what] = float(sigma)
    return parts


def arm_files(
    arm: ArmFile, allotment: Allotment, requirements: Mapping[str, Requirement], layouts: Mapping[str, Candidate]
) -> dict[str, str]:
    """Return the texts of an arm with designed POSORs, by their paths in its folder; its scenario is that of the arm.

    Raises PosorError: a file of the arm cannot be read.
    """
    chain, files = arm.chain(), {}
    bits = max(each.layout.bits(requirements[name].scan_rate.number) for name, each in layouts.items())
    for joint in chain.joints:
        frames = (joint.parent, joint.child)
        designed = layouts[joint.name].layout.calibration(requirements[joint.name], frames)
        calibration = allotment.errors.calibration_with(designed)
        files[f"calibrations/{joint.name}.yaml"] = document_text(calibration.model_dump(mode="json"), made_by(PROGRAM))
    beams = allotted_beams(arm, allotment)
    if beams is not None:
        files[BEAMS] = beams
    if arm.scenario is not None:
        text = read_text(arm.scenario, "scenario file")
        files[SCENARIO] = edit_document(text, str(arm.scenario), {"electronics.converter.bits": bits})
    files[arm.urdf.name] = urdf_with_gaps(chain.urdf, {name: each.layout.gap for name, each in layouts.items()})
    files[ARM_FILE] = arm_text(
        PROGRAM,
        arm.name,
        f"designed for {arm.path.name}",
        urdf=arm.urdf.name,
        endpoint_frame=arm.endpoint_frame,
        beams=BEAMS if beams is not None else None,
        joints={name: {"calibration": f"calibrations/{name}.yaml"} for name in arm.calibrations},
        chain={"parameters": dict(arm.chain_parameters)} if arm.chain_parameters else None,
        driver={"source": arm.driver.source, "parameters": dict(arm.driver.parameters) or None},
        scenario=SCENARIO if arm.scenario is not None else None,
    )
    return files


def urdf_with_gaps(urdf: str, gaps: Mapping[str, float]) -> str:
    """Return a URDF whose POSOR joints have other gaps [m], along Z of their origins' parents."""
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314  own file
    root = ET.fromstring(urdf, parser)  # noqa: S314
    for joint in root.iter("joint"):
        if joint.get("name") in gaps:
            origin = joint.find("origin")
            origin = ET.SubElement(joint, "origin") if origin is None else origin
            x, y, _ = origin.get("xyz", "0 0 0").split()
            origin.set("xyz", f"{x} {y} {gaps[str(joint.get('name'))]:.9g}")
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def allotment_json(allotment: Allotment) -> dict[str, Any]:
    """Return an allotment by name, SI units."""

    def by_axis(values: FloatArray) -> dict[str, float]:
        return dict(zip(AXES, values.tolist(), strict=True))

    return {
        "required": by_axis(allotment.required),
        "postures": [
            {"angles": dict(posture), "endpoint": by_axis(after), "endpoint_at_present": by_axis(before)}
            for posture, after, before in zip(allotment.postures, allotment.endpoint, allotment.before, strict=True)
        ],
        "parts": [
            {
                "part": group.part,
                "beam": group.beam,
                "quantity": group.what,
                "unit": group.unit,
                "allotted": float(sigma),
                "present": float(present),
                "share": float(share),
            }
            for group, sigma, present, share in zip(
                allotment.groups, allotment.allotted, allotment.present, allotment.shares, strict=True
            )
        ],
    }

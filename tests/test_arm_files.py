# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Consistency of the installed arms' files: calibrations, URDF, beams, scenario, and sizes of the thesis."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.chain.beam_bending import Tube
from posor.chain.beams_file import load_beams
from posor_design.observable_causes import unobservable_causes
from posor_drivers.simulator.motion_phases import Spline
from posor_drivers.simulator.scenario import load_scenario
from posor_lab.thesis_data import read_table

ROOT = Path(__file__).resolve().parents[1]
ARMS = ROOT / "ros2_ws" / "src" / "posor_bringup" / "arms"
SCRIPT = ROOT / "data" / "arms" / "make_arm_calibrations.py"
NAMES = ("five_axis", "five_axis_checked", "six_axis", "test_rig")
INCH = 0.0254
PLATE_THICKNESS = 0.5 * INCH
ALUMINIUM = 2700.0


def arm_of(name: str) -> ArmFile:
    return load_arm_file(ARMS / name / "arm.yaml")


def outside_diameter(calibration: dict[str, Any]) -> float:
    tips = np.array([probe["tip"]["value"] for probe in calibration["sensors"][0]["probes"]])
    return float(2.0 * np.linalg.norm(tips, axis=1).mean() + INCH)


def test_calibrations_are_those_of_the_script(tmp_path: Path) -> None:
    output = tmp_path / "generated"
    subprocess.run([sys.executable, str(SCRIPT), str(output)], cwd=tmp_path, check=True, timeout=100)
    generated = {str(path.relative_to(output)): path.read_bytes() for path in output.rglob("*.yaml")}
    installed = {str(path.relative_to(ARMS)): path.read_bytes() for path in ARMS.glob("*/calibrations/*.yaml")}
    assert sorted(generated) == sorted(installed)
    for name, content in generated.items():
        assert content == installed[name], f"{name} differs: run data/arms/{SCRIPT.name}"


@pytest.mark.parametrize("name", NAMES)
def test_files_match_the_joints(name: str) -> None:
    arm = arm_of(name)
    chain = arm.chain()
    assert arm.name == arm.path.parent.name == name
    assert list(arm.calibrations) == [joint.name for joint in chain.joints]
    for joint in chain.joints:
        frames = arm.calibration(joint.name).frames
        assert (frames.parent, frames.child) == (joint.parent, joint.child)
        assert (joint.parent, joint.child) == (f"{joint.name}_receiving", f"{joint.name}_target")
        np.testing.assert_array_equal(joint.T_parent_joint.translation, [0.0, 0.0, 0.000735])
    # The base is rigid; from then on every link is a measuring beam.
    assert chain.links[0].beam is None
    assert all(link.beam is not None for link in chain.links[1:])
    assert arm.scenario is not None
    assert list(load_scenario(arm.scenario).joints) == list(arm.calibrations)


def test_the_readings_of_the_live_arm_of_the_readme_check_one_another() -> None:
    """So its protection level is finite on all axes; six_axis is the recommended one."""
    found = re.search(r"^\./posor bringup (\w+) ", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    for name in (found[1], "six_axis"):
        arm = arm_of(name)
        for joint in arm.calibrations:
            causes = unobservable_causes(arm.calibration(joint))
            assert set(causes) == {"growth of gaps", "wedge of gaps"}  # which their bounds cover


@pytest.mark.parametrize("name", NAMES)
def test_arm_at_zero_is_extended_along_x(name: str) -> None:
    chain = arm_of(name).chain()
    pose = chain.nominal_endpoint({joint.name: 0.0 for joint in chain.joints})
    np.testing.assert_allclose(pose.rotation, np.eye(3), atol=1e-12)
    assert abs(pose.translation[1]) < 3e-3
    assert pose.translation[0] > 0.8


@pytest.mark.parametrize("name", NAMES)
def test_motion_begins_at_the_home_marks_and_stays_within_one_turn(name: str) -> None:
    arm = arm_of(name)
    assert arm.scenario is not None
    scenario = load_scenario(arm.scenario)
    for joint, settings in scenario.joints.items():
        for sensor in arm.calibration(joint).sensors:
            assert settings.start.number == sensor.home_theta
    angles = [phase.through.array for phase in scenario.motion if isinstance(phase, Spline)]
    assert all(np.all(np.abs(waypoints) < math.pi) for waypoints in angles)
    moved = {joint for phase in scenario.motion if isinstance(phase, Spline) for joint in phase.joints}
    assert moved == set(scenario.joints)


@pytest.mark.parametrize(("name", "factor"), [("five_axis", 1.0), ("five_axis_checked", 1.2)])
def test_five_axis_posors_have_the_diameters_of_the_thesis_or_larger_ones(name: str, factor: float) -> None:
    rows = read_table(ROOT / "data" / "slocum1985" / "error_budget_five_axis_robot.csv", ())
    arm = arm_of(name)
    plates = ET.parse(arm.urdf).getroot()  # noqa: S314  our own file
    assert list(arm.calibrations) == [row["joint"].replace(" ", "_") for row in rows]
    for row, (joint, path) in zip(rows, arm.calibrations.items(), strict=True):
        diameter = outside_diameter(yaml.safe_load(path.read_text(encoding="utf-8")))
        assert diameter == pytest.approx(factor * float(row["posor_od_in"]) * INCH, abs=1e-9)
        for side in ("receiving", "target"):
            disc = plates.find(f"link[@name='{joint}_{side}']/visual/geometry/cylinder")
            assert disc is not None
            assert 2.0 * float(disc.get("radius", "nan")) == pytest.approx(diameter, abs=1e-9)


def test_beam_of_the_rig_is_that_of_section_622() -> None:
    [beam] = load_beams(ARMS / "test_rig" / "beams.yaml").beams
    assert beam.sag is not None
    tube = beam.sag.tube
    assert (tube.outer_diameter.number, tube.inner_diameter.number) == pytest.approx((2.0 * INCH, 1.75 * INCH))
    [measured] = arm_of("test_rig").chain().beams
    length = float(np.linalg.norm(measured.T_start_end.translation))
    assert length == pytest.approx(30.0 * INCH)
    np.testing.assert_allclose(beam.sag.gimbals.array, [6.0 * INCH, length - 6.0 * INCH])
    disc = ALUMINIUM * math.pi / 4.0 * (10.0 * INCH) ** 2 * PLATE_THICKNESS
    assert [plate.mass.number for plate in beam.sag.plates] == pytest.approx([disc, disc], rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_masses_of_the_urdf_are_those_of_the_beams_file(name: str) -> None:
    """Target plate and beam are one link; the plate at the far end of the beam is the next link."""
    arm = arm_of(name)
    chain = arm.chain()
    links = {link.get("name"): link for link in ET.parse(arm.urdf).getroot().findall("link")}  # noqa: S314  our own file
    masses = {
        link: float(mass.get("value", "nan"))
        for link, element in links.items()
        if (mass := element.find("inertial/mass")) is not None
    }
    for beam_file, beam, joint in zip(
        load_beams(ARMS / name / "beams.yaml").beams, chain.beams, chain.joints, strict=True
    ):
        if beam_file.sag is None:
            continue
        tube = beam_file.sag.tube
        numbers = (tube.outer_diameter, tube.inner_diameter, tube.modulus, tube.density)
        length = float(np.linalg.norm(beam.T_start_end.translation))
        start, *others = beam_file.sag.plates
        own = start.mass.number + length * Tube(*(each.number for each in numbers)).mass_per_length
        assert masses[joint.child] == pytest.approx(own, rel=1e-3)
        far = "beam_end" if name == "test_rig" else None
        for plate in others:
            assert masses[far or plate.name] == pytest.approx(plate.mass.number, rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_assumptions_are_labelled(name: str) -> None:
    arm = arm_of(name)
    assert arm.beams is not None
    assert arm.scenario is not None
    for path in (arm.urdf, arm.path, arm.beams, arm.scenario, *arm.calibrations.values()):
        assert "assume" in path.read_text(encoding="utf-8").lower(), path

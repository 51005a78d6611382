# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A copy of a simulated arm in a warm shop: its beams have thermometers and gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor.calibration.document_text import document_text
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import read_text
from posor.chain.beams_file import VERSION, BeamsFile, load_beams
from posor.errors import ParameterError
from posor.output_files import write_files
from posor_drivers.simulator.scenario import load_scenario

from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

SHOP_K, BEAM_K = 5.0, 1.0
"""Standard uncertainties of the temperature: common to all beams, so that 95 % are within +-10 K; of each beam."""
OFFSET_K, STEP_K = 8.0, 0.4
"""Temperatures in the scenario, from the reference: of the first beam, and from beam to beam."""
REFERENCE_K = 293.15  # temperature at which the URDF holds
WIDTH_M = 0.1  # of a beam without a tube
COMMENT = "Made by posor_lab shop."


def _temperature(joint: str, neighbour: str, coefficient: float, *, has_tube: bool) -> dict[str, Any]:
    thermometer = {
        "name": joint,
        "reference": quantity(REFERENCE_K, "K"),
        "uncertainty": quantity(0.05, "K"),
        "range": quantity([REFERENCE_K - 25.0, REFERENCE_K + 25.0], "K"),
        "rate": quantity(0.01, "K/s"),
        "age": quantity(5.0, "s"),
        "neighbour": {"name": neighbour, "difference": quantity(6.5 * BEAM_K, "K")},
    }
    width = {} if has_tube else {"width": quantity(WIDTH_M, "m")}
    return {
        "coefficient": {**quantity(coefficient, "1/K"), "sigma": 0.005 * coefficient},
        "deviation": quantity(3.0 * SHOP_K, "K"),
        "spread": quantity(BEAM_K, "K"),
        "gradient": {"along": quantity(0.1, "K"), "across": quantity(0.02, "K"), **width},
        "thermometer": thermometer,
    }


def shop_beams(beams: BeamsFile) -> BeamsFile:
    """Return a beams file with a thermometer on each beam with a temperature, and a shop common to all beams."""
    content = beams.model_dump(mode="json")
    warm = [beam for beam in content["beams"] if beam["temperature"] is not None]
    names = [beam["joint"] for beam in warm]
    for beam, neighbour in zip(warm, [*names[1:], names[-2]], strict=True):
        coefficient = beam["temperature"]["coefficient"]["value"]
        beam["temperature"] = _temperature(beam["joint"], neighbour, coefficient, has_tube=beam["sag"] is not None)
    terms = {"shop_temperature": ("temperature", SHOP_K), "thermometer_scale": ("thermometer", 0.03)}
    shared = {
        term: {"uncertainty": quantity(sigma, "K"), "change": {f"{name}.{key}": quantity(1.0, "1") for name in names}}
        for term, (key, sigma) in terms.items()
    }
    return BeamsFile.model_validate({**content, "version": VERSION, "shared": {**content["shared"], **shared}})


def write_shop_arm(arm: ArmFile, folder: Path) -> Path:
    """Write a copy of an arm in a shop; return the path of its arm file.

    The temperatures of its scenario are constant. Raises PosorError: a file of the arm is invalid, or the arm has no
    beams file or no scenario.
    """
    if arm.beams is None or arm.scenario is None:
        raise ParameterError("has no beams file or no scenario", where=str(arm.path), expected="a simulated arm")
    scenario = load_scenario(arm.scenario).model_dump(mode="json", by_alias=True, exclude_none=True)
    beams = shop_beams(load_beams(arm.beams))
    warm = [beam.joint for beam in beams.beams if beam.thermometer is not None]
    scenario["temperatures"] = {n: {"offset": quantity(OFFSET_K + k * STEP_K, "K")} for k, n in enumerate(warm)}
    changes = {f"joints.{name}.calibration": str(path.absolute()) for name, path in arm.calibrations.items()}
    changes |= {"urdf": str(arm.urdf.absolute()), "beams": "beams.yaml", "scenario": "scenario.yaml"}
    folder.mkdir(parents=True, exist_ok=True)
    write_files(
        {
            folder / "beams.yaml": document_text(beams.model_dump(mode="json", exclude_none=True), COMMENT),
            folder / "scenario.yaml": document_text(scenario, COMMENT),
            folder / "arm.yaml": edit_document(read_text(arm.path, "arm file"), str(arm.path), changes),
        }
    )
    return folder / "arm.yaml"

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A copy of a simulated arm whose beams have accelerometers; natural frequencies by the design calculators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.document_text import document_text
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import read_text
from posor.chain.beams_file import VERSION, BeamsFile, load_beams
from posor.errors import ParameterError
from posor.output_files import write_files
from posor_design import beam_frequencies

from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.chain.beam_entries import SagFile

FREQUENCY_SHARE = 0.01  # standard uncertainty of a natural frequency, relative
DAMPING = 0.01
MODEL_SHARE = 0.08  # relative standard uncertainty of what the oscillator adds: higher modes, shear
READING = 0.03  # standard uncertainty of an accelerometer [m/s^2]
DELAY = 1e-6  # standard uncertainty of the time of a reading [s]; the simulated stamps are exact
SPREAD = 1.0  # of the acceleration without accelerometers [m/s^2]
COMMENT = "Made by posor_lab vibration."


def first_frequency(length: float, sag: SagFile) -> float:
    """Return the first natural frequency of a beam [Hz], by ``posor_design.beam_frequencies``."""
    tube = sag.tube
    masses = [sum(p.mass.number for p in sag.plates if abs(p.at.number - end) < 0.5 * length) for end in (0.0, length)]
    found = beam_frequencies(
        shape="tube",
        height=tube.outer_diameter.number,
        wall=0.5 * (tube.outer_diameter.number - tube.inner_diameter.number),
        length=length,
        modulus=tube.modulus.number,
        density=tube.density.number,
        gimbals=tuple(sag.gimbals.array.tolist()),
        plate_masses=(masses[0], masses[1]),
        modes=1,
    )
    return found.frequencies[0]


def _vibration(name: str, length: float, sag: SagFile, error: float) -> dict[str, Any]:
    frequency = error * first_frequency(length, sag)
    return {
        "frequency": {**quantity(frequency, "Hz"), "sigma": FREQUENCY_SHARE * frequency},
        "damping": quantity(DAMPING, "1"),
        "uncertainty": quantity(MODEL_SHARE, "1"),
        "spread": quantity(SPREAD, "m/s^2"),
        "accelerometers": {
            "names": [f"{name}_near", f"{name}_far"],
            "uncertainty": quantity(READING, "m/s^2"),
            "delay": quantity(DELAY, "s"),
            "range": quantity(1000.0, "m/s^2"),
            "age": quantity(min(0.002, 1.0 / frequency), "s"),
        },
    }


def vibrating_beams(arm: ArmFile, error: float) -> BeamsFile:
    """Return the beams file of an arm with ``vibration`` of each beam with ``sag``; ``error``: of the frequencies."""
    if arm.beams is None or arm.scenario is None:
        raise ParameterError("has no beams file or no scenario", where=str(arm.path), expected="a simulated arm")
    lengths = {beam.name: float(np.linalg.norm(beam.T_start_end.translation)) for beam in arm.chain().beams}
    beams = load_beams(arm.beams)
    content = beams.model_dump(mode="json")
    for own, beam in zip(content["beams"], beams.beams, strict=True):
        if beam.sag is not None:
            own["vibration"] = _vibration(beam.joint, lengths[beam.joint], beam.sag, error)
    return BeamsFile.model_validate({**content, "version": VERSION})


def write_vibrating_arm(arm: ArmFile, folder: Path, *, frequency_error: float = 1.0) -> Path:
    """Write a copy of an arm with accelerometers; return the path of its arm file.

    ``frequency_error``: by what the natural frequencies of the file are wrong, as a factor, for controls. Raises
    PosorError: a file of the arm is invalid, or the arm has no beams file or no scenario.
    """
    changes = {f"joints.{name}.calibration": str(path.absolute()) for name, path in arm.calibrations.items()}
    changes |= {"urdf": str(arm.urdf.absolute()), "beams": "beams.yaml", "scenario": str(arm.scenario)}
    content = document_text(vibrating_beams(arm, frequency_error).model_dump(mode="json", exclude_none=True), COMMENT)
    folder.mkdir(parents=True, exist_ok=True)
    text = edit_document(read_text(arm.path, "arm file"), str(arm.path), changes)
    write_files({folder / "beams.yaml": content, folder / "arm.yaml": text})
    return folder / "arm.yaml"

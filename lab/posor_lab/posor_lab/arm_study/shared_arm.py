# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A copy of a simulated arm whose files state the errors of one laboratory, common to all joints and beams."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.calibration.calibration_file import load_calibration
from posor.calibration.document_text import document_text
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import read_text
from posor.chain.beams_file import load_beams
from posor.output_files import write_files
from posor.uncertainty.common_errors import CommonErrors

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

LABORATORY = CommonErrors(length_scale=1e-6, temperature=1.0)
"""1 ppm of length, 1 K, parts of aluminium: five_axis is 1.93 m long, so 1.93 um and 44 um at the endpoint."""
COMMENT = "Made by posor_lab arm --shared-terms."


def write_shared_arm(arm: ArmFile, folder: Path) -> Path:
    """Write a copy of an arm with the errors of ``LABORATORY`` stated; return the path of its arm file.

    Raises PosorError: a file of the arm is invalid.
    """
    texts = {
        f"{name}.yaml": LABORATORY.calibration_with(load_calibration(path)) for name, path in arm.calibrations.items()
    }
    files = {name: document_text(each.model_dump(mode="json"), COMMENT) for name, each in texts.items()}
    changes = {f"joints.{name}.calibration": str((folder / f"{name}.yaml").absolute()) for name in arm.calibrations}
    for key, path in (("urdf", arm.urdf), ("scenario", arm.scenario)):
        if path is not None:
            changes[key] = str(path.absolute())
    if arm.beams is not None:
        beams = LABORATORY.beams_with(load_beams(arm.beams))
        files["beams.yaml"] = document_text(beams.model_dump(mode="json"), COMMENT)
        changes["beams"] = str((folder / "beams.yaml").absolute())
    files["arm.yaml"] = edit_document(read_text(arm.path, "arm file"), str(arm.path), changes)
    folder.mkdir(parents=True, exist_ok=True)
    write_files({folder / name: text for name, text in files.items()})
    return folder / "arm.yaml"

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The identity of an arm: one hash over the calibrations in force, URDF, beams file and commissioning record.

A controller compares one string. Which part differs is found by comparing the parts.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from posor.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration

ID_DIGITS = 16  # hexadecimal digits of a calibration's id
NOT_STATED = 0
"""Id of a transform that does not state its calibration."""


def calibration_id(calibration: Calibration) -> int:
    """Return the id of a calibration in force, its session and digital zero applied: 64 bits of its content hash."""
    return int(calibration.content_hash[:ID_DIGITS], 16)


def format_id(number: int) -> str:
    """Return the id of a calibration as hexadecimal digits."""
    return f"{number:0{ID_DIGITS}x}"


def file_sha256(path: Path | None) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits; empty without a file.

    Raises CalibrationError: the file cannot be read.
    """
    if path is None:
        return ""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise CalibrationError(f"cannot be read: {error.strerror}", where=str(path)) from error


@dataclass(frozen=True)
class ArmIdentity:
    """The parts of an arm's identity, as hexadecimal digits."""

    calibrations: Mapping[str, str]  # id of the calibration in force, by joint
    urdf: str  # SHA-256 of the file
    beams: str  # SHA-256 of the file; empty: no beams file
    record: str = ""  # SHA-256 of the content of the commissioning record; empty: not commissioned

    @property
    def sha256(self) -> str:
        """The identity, 64 hexadecimal digits."""
        text = json.dumps(asdict(self), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def with_calibrations(self, ids: Mapping[str, int], record: str) -> ArmIdentity:
        """Return the identity with other calibrations, by their ids, and another record."""
        return replace(self, calibrations={name: format_id(number) for name, number in ids.items()}, record=record)

    def differences(self, commissioned: ArmIdentity) -> dict[str, str]:
        """Return a clause for each joint or file that differs from the commissioned one; the record is not compared."""
        before = commissioned.calibrations
        found = {
            joint: f"calibration of {joint} is {number}, not {before.get(joint, 'known')}"
            for joint, number in self.calibrations.items()
            if number != before.get(joint)
        }
        for name, own, other in (
            ("URDF", self.urdf, commissioned.urdf),
            ("beams file", self.beams, commissioned.beams),
        ):
            if own != other:
                found[name] = f"another {name}"
        return found

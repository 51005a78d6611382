# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commissioning record of an arm, version 1: which files were in force when the arm passed, and its results.

``posor commission`` writes it; the arm file names it with the key ``commissioning``; chain_node compares the arm with
it. It states the identity that ``endpoint/state`` carries as long as nothing has been exchanged since.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import AfterValidator, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.calibration.yaml_document import load_document
from posor.chain.identity import ID_DIGITS, ArmIdentity

if TYPE_CHECKING:
    from pathlib import Path

FILE_KIND = "commissioning record"
VERSION = 1
NATIVE = ("x", "y", "gap", "alpha", "beta", "theta")
"""Native coordinates of a joint: [m], [m], [m], [rad], [rad], [rad]."""


def _check_hash(text: str) -> str:
    if not re.fullmatch(r"([0-9a-f]{64})?", text):
        raise EntryError(format_value(text), expected="64 hexadecimal digits")
    return text


def _check_id(text: str) -> str:
    if not re.fullmatch(f"[0-9a-f]{{{ID_DIGITS}}}", text):
        raise EntryError(format_value(text), expected=f"{ID_DIGITS} hexadecimal digits")
    return text


Sha256 = Annotated[str, AfterValidator(_check_hash)]
CalibrationId = Annotated[str, AfterValidator(_check_id)]
Span = tuple[float, float]


class CommissionedFiles(FrozenModel):
    """The files in force: ids of the calibrations with their sessions applied; SHA-256 of the others, empty: none."""

    calibrations: dict[str, CalibrationId]
    urdf: Sha256
    beams: Sha256


class CheckRecord(FrozenModel):
    """One check: what it checked, what it found, the kind of what is wrong, and what the check cannot find."""

    check: str
    found: str
    verdict: Literal["passed", "failed", "not_checked"]
    kind: str = ""
    blind: str = ""


class CommissioningContent(FrozenModel):
    """A record but for its identity; ``limits``: least and greatest observed native coordinates of each joint."""

    format: Literal["posor_commissioning"] = "posor_commissioning"
    version: Literal[1] = 1
    arm: str
    serial: str
    date: str
    software: str
    files: CommissionedFiles
    checks: tuple[CheckRecord, ...]
    limits: dict[str, dict[str, Span]]

    def parts(self) -> ArmIdentity:
        """Return the parts of the commissioned identity."""
        content = self.model_dump(mode="json", exclude={"identity"})
        record = hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
        return ArmIdentity(self.files.calibrations, self.files.urdf, self.files.beams, record)

    def record(self) -> CommissioningRecord:
        """Return the content with its identity."""
        return CommissioningRecord(**self.model_dump(), identity=self.parts().sha256)


class CommissioningRecord(CommissioningContent):
    """Content of a commissioning record; ``identity`` follows from everything else."""

    identity: Sha256

    @model_validator(mode="after")
    def _check_identity(self) -> Self:
        if self.identity != self.parts().sha256:
            what = "identity does not follow from the content, so the record was changed"
            raise EntryError(what, key=("identity",), expected="the file as 'posor commission' wrote it")
        return self


def load_record(path: Path) -> CommissioningRecord:
    """Read a commissioning record.

    Raises CalibrationError: the file cannot be read, has invalid content, or was changed.
    """
    keys = "format, version, arm, files, checks, limits, identity"
    return load_document(path, FILE_KIND, keys, VERSION, CommissioningRecord.model_validate)[0]

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files behind a statement, with hashes, and the places of single numbers in them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.bags.calibration_recording import bag_sha256
from posor.calibration.yaml_document import FileLocations, parse_yaml
from posor.chain.identity import file_sha256
from posor.input_text import read_input_text

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

ARM, URDF, BEAMS, RECORD, BAG, PATH = "arm file", "URDF", "beams file", "commissioning record", "bag", "path"
_PART = re.compile(r"[^.\[\]]+|\[\d+\]")


def calibration_of(joint: str) -> str:
    """Return the role of the calibration file of a joint."""
    return f"calibration of {joint}"


@dataclass(frozen=True)
class Origin:
    """The place of a number: a line of a record, or the record as a whole."""

    role: str  # of the record
    file: str  # name of the file
    line: int = 0  # 0: the whole record
    key: str = ""  # such as ``beams[0].sag.uncertainty``; empty: none

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" if self.line else self.file


@dataclass(frozen=True)
class Record:
    """A file that a statement rests on."""

    role: str
    path: Path
    sha256: str
    text: str  # content of a text file; empty: a bag
    source: str = ""  # provenance as the file states; empty: not stated
    date: str = ""


class Records:
    """All files behind a statement, by role."""

    def __init__(self, arm: ArmFile, bag: Path | None = None, path: Path | None = None) -> None:
        """Read the files. Raises CalibrationError: a file cannot be read."""
        files = {ARM: arm.path, URDF: arm.urdf, BEAMS: arm.beams}
        files |= {calibration_of(joint): file for joint, file in arm.calibrations.items()}
        if arm.commissioning is not None and arm.commissioning.exists():
            files[RECORD] = arm.commissioning
        files[PATH] = path
        self.all: dict[str, Record] = {}
        self._locations: dict[str, FileLocations] = {}
        for role, file in files.items():
            if file is not None:
                self._read(role, file)
        if bag is not None:
            self.all[BAG] = Record(BAG, bag, bag_sha256(bag), "")

    def _read(self, role: str, path: Path) -> None:
        sha256, text = file_sha256(path), read_input_text(path)
        root, content = parse_yaml(text, str(path)) if path.suffix in {".yaml", ".yml"} else (None, {})
        if root is not None:
            self._locations[role] = FileLocations(str(path), root)
        stated = content.get("provenance", content) if isinstance(content, dict) else {}
        source, date = (str(stated.get(key, "")) for key in ("source", "date"))
        self.all[role] = Record(role, path, sha256, text, source, date)

    def origin(self, role: str, *location: str | int) -> Origin:
        """Return the place of an entry of a file, or of the nearest entry around it; without location the file."""
        name = self.all[role].path.name
        if not location or role not in self._locations:
            return Origin(role, name)
        return Origin(role, name, *self._locations[role].find(*location))

    def origin_of_key(self, role: str, key: str) -> Origin:
        """Return the place of a dotted key, such as ``sensors[0].probes[1].tip``."""
        parts = [int(part[1:-1]) if part.startswith("[") else part for part in _PART.findall(key)]
        return self.origin(role, *parts)

    def __contains__(self, role: object) -> bool:
        return role in self.all

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the numbers of a bag come from: calibrations and their sessions, URDF and beams file, version of the software.

The recorder and ``reprocess`` write them into the ``custom_data`` of a bag's metadata.yaml. A bag that is reprocessed
with other files is reprocessed nevertheless, because that is often the purpose; the differences are named.
"""

from __future__ import annotations

import json
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from posor.bags.recorded_topics import METADATA
from posor.calibration.calibration_file import load_calibration
from posor.chain.identity import file_sha256

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.bags.reprocess_task import Settings

SOFTWARE = "posor.software"
FILES = ("urdf", "beams")  # parameters of chain_node that name files
CALIBRATION, SESSION = "posor.calibration.", "posor.session."  # before the name of a joint
NONE = "none"  # in place of a file or session that is not used
PENDING = "custom_data.json"  # custom data of a bag that is being written; its metadata.yaml is written at the end


def provenance_of(settings: Settings | None) -> dict[str, str]:
    """Return the version of the software, hashes of the files of an arm, if any, and sessions, as custom data of a bag.

    A calibration has its content hash, which does not depend on layout and comments; other files their SHA-256. Raises
    CalibrationError: a calibration is invalid, or a file cannot be read.
    """
    return {key: value for key, (_, value) in _origin(settings).items()}


def differences(recorded: Mapping[str, str], settings: Settings) -> tuple[str, ...]:
    """Return a sentence for each file, session, and for the software, that differs from what a bag was recorded with.

    ``recorded``: custom data of the bag; ``settings``: with which it is processed; what the bag does not name is not
    compared. Raises CalibrationError: a calibration is invalid, or a file cannot be read.
    """
    return tuple(
        f"{name}{value}; the bag was recorded with {recorded[key]}"
        for key, (name, value) in _origin(settings).items()
        if key in recorded and recorded[key] != value
    )


def custom_data(bag: Path) -> dict[str, str]:
    """Return the custom data of a bag, also of one whose recording was killed; empty for a single file."""
    for name, read in ((METADATA, _of_metadata), (PENDING, json.loads)):
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError):
            return {str(key): str(value) for key, value in read((bag / name).read_text(encoding="utf-8")).items()}
    return {}


def _software() -> str:
    return f"posor {version('posor')}"


def _of_metadata(text: str) -> dict[str, Any]:
    return dict(yaml.safe_load(text)["rosbag2_bagfile_information"].get("custom_data") or {})


def _origin(settings: Settings | None) -> dict[str, tuple[str, str]]:
    """Return the beginning of a sentence, and the value, by the keys of the custom data."""
    origin = {SOFTWARE: ("this software: ", _software())}
    if settings is None:
        return origin
    for joint, each in settings.joints.items():
        hashed = load_calibration(each.calibration).content_hash
        origin[f"{CALIBRATION}{joint}"] = f"{each.calibration}: hash ", hashed
        origin[f"{SESSION}{joint}"] = f"session of {joint}: ", each.session or NONE
    if settings.chain is None:
        return origin
    for name in FILES:
        path = settings.chain.get(name)
        found = (f"{path}: hash ", file_sha256(Path(str(path)))) if path else (f"{name} file: ", NONE)
        origin[f"posor.{name}"] = found
    return origin

"""Read a calibration file; every complaint names the file, the line and the key."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationError

from posor_estimator.core.calibration.entry import shown
from posor_estimator.core.calibration.model import VERSION, Calibration, calibration_from
from posor_estimator.core.calibration.places import place
from posor_estimator.core.calibration.sentences import first_complaint
from posor_estimator.core.calibration.strict_yaml import read_yaml
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from pathlib import Path


def load_calibration(path: Path) -> Calibration:
    """Read and validate a calibration file (YAML, SI).

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or says something that cannot be.

    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise CalibrationError(
            f"cannot be read: {reason}", where=f"calibration file {path}", expected="a YAML calibration file"
        ) from error
    source = str(path)
    root, content = read_yaml(text, source)
    if not isinstance(content, dict):
        raise CalibrationError(
            "is not a mapping", where=f"{path}, line 1", expected="format, version, name, provenance, frames, sensors"
        )
    version = content.get("version")
    # Of the same type too: True and 1.0 are equal to 1.
    if type(version) is not int or version != VERSION:
        what = f"version {shown(version)}" if "version" in content else "key 'version' is missing"
        raise CalibrationError(what, where=place(source, root, ("version",)), expected=str(VERSION))
    try:
        return calibration_from(content)
    except ValidationError as error:
        complaint = first_complaint(error)
        where = place(source, root, complaint.location)
        raise CalibrationError(complaint.what, where=where, expected=complaint.expected) from error

"""Read a calibration file, or another file of its manner; every complaint names the file, the line and the key."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from pydantic import ValidationError

from posor_estimator.core.calibration.entry import shown
from posor_estimator.core.calibration.model import FORMER_VERSIONS, VERSION, Calibration, calibration_from
from posor_estimator.core.calibration.places import Places
from posor_estimator.core.calibration.sentences import first_complaint
from posor_estimator.core.calibration.strict_yaml import read_yaml
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Any

Document = TypeVar("Document")
KIND = "calibration file"


def load_calibration(path: Path) -> Calibration:
    """Read and validate a calibration file (YAML, SI).

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or says something that cannot be.

    """
    return calibration_of(read_text(path, KIND), str(path))


def calibration_of(text: str, source: str) -> Calibration:
    """Read a calibration as ``load_calibration`` does, from text; ``source`` is what to call it in complaints."""
    keys = "format, version, name, provenance, frames, sensors"
    return document_of(text, source, keys, VERSION, calibration_from, former=FORMER_VERSIONS)[0]


def load_document(
    path: Path,
    kind: str,
    keys: str,
    version: int,
    validate: Callable[[dict[str, Any]], Document],
) -> tuple[Document, Places]:
    """Read a YAML file that states its version, and validate what it says; return that, and where it stands.

    Args:
        path: The file.
        kind: What to call it in complaints, such as ``calibration file``.
        keys: The keys that it must have, in words.
        version: The version of its format.
        validate: Makes the document of its content; raises pydantic's ValidationError.

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or says something that cannot be.

    """
    return document_of(read_text(path, kind), str(path), keys, version, validate)


def read_text(path: Path, kind: str) -> str:
    """Return the text of a file.

    Raises:
        CalibrationError: It cannot be read.

    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise CalibrationError(
            f"cannot be read: {reason}", where=f"{kind} {path}", expected=f"a YAML {kind}"
        ) from error


def document_of(
    text: str,
    source: str,
    keys: str,
    version: int,
    validate: Callable[[dict[str, Any]], Document],
    *,
    former: tuple[int, ...] = (),
) -> tuple[Document, Places]:
    """Read a document as ``load_document`` does, from text.

    Args:
        text: The document.
        source: What to call it in complaints.
        keys: See ``load_document``.
        version: See ``load_document``.
        validate: See ``load_document``.
        former: Older versions that are read too.

    Raises:
        CalibrationError: It is not YAML, or says something that cannot be.

    """
    root, content = read_yaml(text, source)
    places = Places(source, root)
    if not isinstance(content, dict):
        raise CalibrationError("is not a mapping", where=f"{source}, line 1", expected=keys)
    said = content.get("version")
    # Of the same type too: True and 1.0 are equal to 1.
    if type(said) is not int or said not in (version, *former):
        what = f"version {shown(said)}" if "version" in content else "key 'version' is missing"
        known = " or ".join(str(number) for number in (*former, version))
        raise CalibrationError(what, where=places.of("version"), expected=known)
    try:
        return validate(content), places
    except ValidationError as error:
        complaint = first_complaint(error)
        where = places.of(*complaint.location)
        raise CalibrationError(complaint.what, where=where, expected=complaint.expected) from error

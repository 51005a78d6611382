"""Read a calibration file; every complaint names the file, the line and the key."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

import yaml
from pydantic import ValidationError

from posor_estimator.core.calibration.model import VERSION, Calibration, calibration_from
from posor_estimator.core.calibration.quantity import FrozenModel
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from pathlib import Path

    from pydantic_core import ErrorDetails


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
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        content = yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        line = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise CalibrationError(f"is not YAML: {error.problem}", where=f"{path}{line}") from error
    if not isinstance(content, dict):
        raise CalibrationError(
            "is not a mapping", where=f"{path}, line 1", expected="format, version, name, provenance, frames, sensors"
        )
    version = content.get("version")
    if version != VERSION:
        raise CalibrationError(f"version {version!r}", where=_place(path, root, ("version",)), expected=str(VERSION))
    try:
        return calibration_from(content)
    except ValidationError as error:
        raise _as_sentence(error, path, root) from error


def _as_sentence(error: ValidationError, path: Path, root: yaml.Node | None) -> CalibrationError:
    """Return the first complaint of pydantic as one sentence."""
    details = error.errors(include_url=False)
    first = details[0]
    location = first["loc"]
    message = first["msg"].removeprefix("Value error, ")
    what, _, expected = message.partition(", expected ")
    if first["type"] == "extra_forbidden":
        what = f"unknown key '{location[-1]}'"
        expected = _nearest(str(location[-1]))
    elif first["type"] == "missing":
        what, expected = f"key '{location[-1]}' is missing", ""
    elif not expected and _is_plain(first):
        what = f"{what} (it is {first['input']!r})"
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return CalibrationError(f"{what}{more}", where=_place(path, root, location), expected=expected)


def _is_plain(details: ErrorDetails) -> bool:
    return isinstance(details["input"], str | int | float | bool)


def _nearest(key: str) -> str:
    """Name the known key that looks most like an unknown one."""
    known = {name for model in _models() for name in model.model_fields}
    close = difflib.get_close_matches(key, sorted(known), n=1)
    return f"'{close[0]}'" if close else "a key of the format"


def _models() -> list[type[FrozenModel]]:
    """Return every model of the format, found by walking the subclasses of ``FrozenModel``."""
    found: list[type[FrozenModel]] = []
    queue: list[type[FrozenModel]] = [FrozenModel]
    while queue:
        model = queue.pop()
        found.append(model)
        queue.extend(model.__subclasses__())
    return found


def _place(path: Path, root: yaml.Node | None, location: tuple[int | str, ...]) -> str:
    """Return ``file, line n, key a.b[0].c``; parts of a location that are no keys (union tags) are left out."""
    node = root
    line = 1
    key = ""
    for part in location:
        child: yaml.Node | None = None
        if isinstance(node, yaml.MappingNode):
            for name, value in node.value:
                if name.value == str(part):
                    child, line = value, name.start_mark.line + 1
                    key += f".{part}"
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            child = node.value[part]
            line = child.start_mark.line + 1
            key += f"[{part}]"
        if child is not None:
            node = child
    return f"{path}, line {line}" + (f", key {key.lstrip('.')}" if key else "")

"""Say what pydantic found wrong in a calibration file in one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor_estimator.core.calibration.entry import TEXT, EntryError, shown

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails

_KEY = "[key]"  # pydantic's mark for the key of an entry, at the end of a location

# What would be right, by pydantic's names of errors; braces are filled in from the error's context.
_EXPECTED = {
    "string_type": TEXT,
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "too_short": "at least {min_length}",
    "too_long": "at most {max_length}",
}


@dataclass(frozen=True)
class Complaint:
    """What is wrong, where (keys and indices from the root), and what would be right."""

    what: str
    location: tuple[str | int, ...]
    expected: str = ""


def first_complaint(error: ValidationError) -> Complaint:
    """Return the first thing that is wrong, and how many more there are."""
    details = error.errors(include_url=False)
    complaint = _complaint(details[0])
    if len(details) == 1:
        return complaint
    return Complaint(f"{complaint.what} (and {len(details) - 1} more)", complaint.location, complaint.expected)


def _complaint(details: ErrorDetails) -> Complaint:
    kind, location, value = details["type"], details["loc"], details["input"]
    context: dict[str, Any] = details.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, EntryError):
        return Complaint(cause.what, (*location, *cause.key), cause.expected)
    if isinstance(cause, Exception):
        return Complaint(str(cause).rstrip("."), location)
    if kind == "missing":
        return Complaint(f"key '{location[-1]}' is missing", location[:-1])
    if location and location[-1] == _KEY:
        return Complaint(f"key {shown(value)} is not text", location[:-1], TEXT)
    if kind not in _EXPECTED:
        return Complaint(f"{details['msg']} (it is {shown(value)})", location)
    what = f"has {context['actual_length']} entries" if kind.startswith("too_") else shown(value)
    return Complaint(what, location, _EXPECTED[kind].format(**context))

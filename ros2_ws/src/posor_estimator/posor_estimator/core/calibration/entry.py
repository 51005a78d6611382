"""An entry of a calibration file that is wrong, and how such entries are shown."""

from __future__ import annotations

import datetime as dt
import reprlib

from posor_estimator.errors import CalibrationError

TEXT = "text, in quotes where YAML would take it for something else"

_SHORT = reprlib.Repr()
_SHORT.maxlist = _SHORT.maxtuple = 12
_SHORT.maxstring = 80


class EntryError(CalibrationError, ValueError):
    """What a validator of a calibration raises; pydantic adds to it where in the file the validated part stands.

    Attributes:
        key: Keys and indices that lead from the validated part to the wrong entry; empty for the part itself.

    """

    def __init__(self, what: str, *, key: tuple[str | int, ...] = (), expected: str = "") -> None:
        super().__init__(what, expected=expected)
        self.key = key


def shown(value: object) -> str:
    """Return a value much as the file has it, cut where it is long."""
    if isinstance(value, dt.date):
        return value.isoformat()
    return _SHORT.repr(value)

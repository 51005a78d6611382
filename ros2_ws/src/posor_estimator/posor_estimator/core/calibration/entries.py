"""Which number of a calibration file each entry of a stack's parameter vector is, whatever types the sensors are of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.stack import Stack

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration


@dataclass(frozen=True)
class Entry:
    """One number of a calibration file.

    Attributes:
        key: Of the quantity: ``sensors[0].probes[1].tip``.
        index: Of the component; empty for a quantity of one number.
        quantity: The quantity as it is now.

    """

    key: str
    index: tuple[int, ...]
    quantity: Quantity

    @property
    def name(self) -> str:
        """Key with the index behind it: ``sensors[0].probes[1].tip[2]``."""
        return self.key + "".join(f"[{i}]" for i in self.index)


def entries_of(calibration: Calibration, session: str = "") -> list[Entry | None]:
    """Return the number behind each entry of the stack's parameter vector, (p,); None for one that no file gives.

    The sensors themselves say it: each number's standard uncertainty is replaced by a mark of its own, and the sensors
    built from that show where the marks come out. So what a session replaces is found under the session's keys.

    Raises:
        CalibrationError: There is no such session.

    """
    marks: list[Entry] = []
    marked = _marked(calibration, "", marks).for_session(session)
    stack = Stack([sensor.build() for sensor in marked.sensors])
    return [marks[int(mark) - 1] if mark else None for mark in stack.parameter_sigmas]


Part = TypeVar("Part")


def _marked(part: Part, key: str, marks: list[Entry]) -> Part:
    """Return a copy whose quantities have the running number of their entry for each sigma."""
    marked: Any = part
    if isinstance(part, Quantity):
        shape = part.array.shape
        numbers = np.arange(part.array.size, dtype=float).reshape(shape) + len(marks) + 1
        marks.extend(Entry(key, index, part) for index in np.ndindex(shape))
        marked = Quantity(value=part.value, sigma=numbers.tolist(), unit=part.unit)
    elif isinstance(part, FrozenModel):
        fields = {name: getattr(part, name) for name in type(part).model_fields}
        inner = {name: _marked(value, f"{key}.{name}".lstrip("."), marks) for name, value in fields.items()}
        marked = part.model_copy(update=inner)
    elif isinstance(part, list):
        marked = [_marked(value, f"{key}[{i}]", marks) for i, value in enumerate(part)]
    elif isinstance(part, dict):
        marked = {name: _marked(value, f"{key}.{name}", marks) for name, value in part.items()}
    copy: Part = marked
    return copy

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a calibration file behind the entries of a stack's parameter vector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from posor.calibration.file_model import FrozenModel
from posor.calibration.quantity import Quantity

Part = TypeVar("Part")


class WithSessions(Protocol):
    """A calibration, as far as this module needs it."""

    def for_session(self, name: str) -> Any:
        """Return the calibration with a session applied."""


@dataclass(frozen=True)
class ParameterEntry:
    """One number of a calibration file."""

    key: str  # key of the quantity: ``sensors[0].probes[1].tip``
    index: tuple[int, ...]  # index of the component; empty for a scalar quantity
    quantity: Quantity

    @property
    def name(self) -> str:
        """Key and index: ``sensors[0].probes[1].tip[2]``."""
        return self.key + "".join(f"[{i}]" for i in self.index)


def parameter_entries(calibration: WithSessions, session: str = "") -> list[ParameterEntry | None]:
    """Return the number of the file behind each entry of the stack's parameter vector, (p,); None: not from a file.

    The order is found from the sensors themselves, whatever their types: each standard uncertainty is replaced by a
    running number, and the parameters of sensors built from that copy show where the numbers come out. A value replaced
    by a session is found under the session's key.

    Raises CalibrationError: the session is unknown.
    """
    entries: list[ParameterEntry] = []
    numbered = _numbered(calibration, "", entries).for_session(session)
    numbers = np.concatenate([sensor.build().parameter_sigmas for sensor in numbered.sensors])
    return [entries[int(number) - 1] if number else None for number in numbers]


def _numbered(part: Part, key: str, entries: list[ParameterEntry]) -> Part:
    """Return a copy in which each sigma is the running number of its entry, from 1."""
    copy: Any = part
    if isinstance(part, Quantity):
        shape = part.array.shape
        numbers = np.arange(part.array.size, dtype=float).reshape(shape) + len(entries) + 1
        entries.extend(ParameterEntry(key, index, part) for index in np.ndindex(shape))
        copy = Quantity.model_construct(value=part.value, sigma=numbers.tolist(), unit=part.unit)
    elif isinstance(part, FrozenModel):
        fields = {name: getattr(part, name) for name in type(part).model_fields}
        numbered = {name: _numbered(value, f"{key}.{name}".lstrip("."), entries) for name, value in fields.items()}
        copy = part.model_copy(update=numbered)
    elif isinstance(part, list):
        copy = [_numbered(value, f"{key}[{i}]", entries) for i, value in enumerate(part)]
    elif isinstance(part, dict):
        copy = {name: _numbered(value, f"{key}.{name}", entries) for name, value in part.items()}
    result: Part = copy
    return result

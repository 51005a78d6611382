"""One scan's raw readings as the core sees them: the fields of ``posor_msgs/RawScan`` without ROS."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from posor_estimator.core.types import FloatArray  # noqa: TC001  needed by dataclass users at run time

NO_SOURCE = 255


def _empty() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True)
class Scan:
    """Raw readings of one exposure.

    Attributes:
        number: Scan number.
        gap_voltages: Gap probe outputs [V], shape (probes,).
        ring_voltages: Ring probe outputs [V], shape (probes,).
        diode_currents: Contact currents A, B, C, D of each diode [A], shape (diodes, 4).
        lit_sources: Index of the source lit for each diode, NO_SOURCE for none.
        supply_voltage: Supply of the probe electronics [V], NaN when not measured.
        temperature: Of the receiving plate [K], NaN when not measured.

    """

    number: int = 0
    gap_voltages: FloatArray = field(default_factory=_empty)
    ring_voltages: FloatArray = field(default_factory=_empty)
    diode_currents: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    lit_sources: tuple[int, ...] = ()
    supply_voltage: float = float("nan")
    temperature: float = float("nan")

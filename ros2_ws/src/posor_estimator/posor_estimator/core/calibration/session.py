"""What changes from one measuring session to the next while the rest of a calibration stands."""

from __future__ import annotations

from typing import Annotated

from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import ANY, Quantity, measured


class Session(FrozenModel):
    """Replacements for one session; what is left out stays as the calibration has it.

    Attributes:
        note: Where the replacements come from.
        zero_shifts: To be added to each gap probe's voltage [V] (thesis table 8.1).
        diode_map: Name of the diode maps to use, a key of the diodes' ``maps``.

    """

    note: str
    zero_shifts: Annotated[Quantity, measured("V", ANY)] | None = None
    diode_map: str | None = None

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Values of a calibration that change from one measuring session to the next."""

from __future__ import annotations

from typing import Annotated

from posor.calibration.file_model import FrozenModel
from posor.calibration.quantity import ANY, Quantity, measured


class Session(FrozenModel):
    """Replacements for one session; all other values stay."""

    note: str  # origin of the replacements
    # added to the voltage of each gap probe [V] (thesis table 8.1)
    zero_shifts: Annotated[Quantity, measured("V", ANY)] | None = None
    diode_map: str | None = None  # name of the diode maps to use, a key of the diodes' ``maps``

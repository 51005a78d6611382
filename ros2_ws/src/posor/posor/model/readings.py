# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sources of raw readings, and the codes of readings that cannot be linearised."""

from __future__ import annotations

from posor.model import diode, voltage
from posor.model.fault import Fault
from posor.numerics.compiled import in_place

GAP_VOLTAGES, RING_VOLTAGES, DIODE_CURRENTS, PYTHON = 0, 1, 2, 3
SOURCE_NAMES = ("gap voltages", "ring voltages", "diode currents")
"""Sources of readings, and their names; those of PYTHON are linearised by a sensor written in plain Python."""

VALID = 0
WRONG_COUNT = -1
WRONG_SOURCES = -2
WRONG_SOURCE = -3
"""Codes of a sensor's readings; below WRONG_SOURCE: of diode (WRONG_SOURCE - code). Positive codes: model.voltage,
1 + 2 * probe for NOT_FINITE, 2 + 2 * probe for OUT_OF_RANGE, and model.diode, code + CODES * diode."""

_BAD_READING, _DARK_DIODE = int(Fault.BAD_READING), int(Fault.DARK_DIODE)
_OUT_OF_RANGE, _SOURCE = int(Fault.OUT_OF_RANGE), int(Fault.SOURCE)


@in_place
def fault_of_code(source: int, code: int) -> int:
    """Return the ``Fault`` that a sensor's code means."""
    fault = _BAD_READING
    if source != DIODE_CURRENTS:
        if code > 0 and (code - 1) % 2 + 1 == voltage.OUT_OF_RANGE:
            fault = _OUT_OF_RANGE
    elif code == WRONG_COUNT:
        fault = _BAD_READING
    elif code < 0 or code % diode.CODES == diode.BRIGHT:
        fault = _SOURCE
    elif code % diode.CODES == diode.DARK:
        fault = _DARK_DIODE
    elif code % diode.CODES >= diode.OUTSIDE_X:
        fault = _OUT_OF_RANGE
    return fault

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The largest error of the clock of this host, as its time service states it: ``chronyc`` (NTP) or ``pmc`` (PTP).

The bound of chrony is root dispersion plus half of the root delay (RFC 5905, section 4), and the system time's offset
from the time that chrony estimates, which it removes slowly. ``pmc`` shows
the offset from the master and the mean path delay of linuxptp; the sum of the offset and half of the delay is taken.
Where a host has neither program, or is not synchronised, nothing is stated.
"""

from __future__ import annotations

import re
import subprocess
import time
from shutil import which
from threading import Thread
from typing import TYPE_CHECKING

from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Mapping

READ_EVERY_S, TIMEOUT_S = 10.0, 1.0
NOT_SYNCHRONISED = "Not synchronised"
OFFSET, DELAY, DISPERSION, LEAP = 4, 10, 11, 13  # columns of ``chronyc -c tracking``; times in seconds
PMC_TIME = r"{}\s+(-?\d+(?:\.\d+)?)"  # a time of ``pmc`` [ns]


def read_chrony(answer: str) -> float | None:
    """Return the largest error by the answer of ``chronyc -c tracking`` [s]; None: not synchronised."""
    columns = answer.strip().split(",")
    if len(columns) <= LEAP or columns[LEAP] == NOT_SYNCHRONISED:
        return None
    return abs(float(columns[OFFSET])) + float(columns[DISPERSION]) + 0.5 * float(columns[DELAY])


def read_ptp(answer: str) -> float | None:
    """Return the largest error by the answer of ``pmc 'GET CURRENT_DATA_SET'`` [s]; None: no slave of a master."""
    found = [re.search(PMC_TIME.format(name), answer) for name in ("offsetFromMaster", "meanPathDelay")]
    steps = re.search(r"stepsRemoved\s+(\d+)", answer)
    if steps is None or steps[1] == "0" or found[0] is None or found[1] is None:
        return None
    return (abs(float(found[0][1])) + 0.5 * abs(float(found[1][1]))) / NS


SERVICES = {
    "pmc": (("pmc", "-u", "-b", "0", "GET CURRENT_DATA_SET"), read_ptp),
    "chronyc": (("chronyc", "-c", "tracking"), read_chrony),
}
"""Questions to time services, and how their answers are read, in the order of preference."""


class HostClock:
    """Asks the time service now and then, in a thread of its own: the service may take a second to answer."""

    def __init__(self) -> None:
        """Ask for the first time, and wait for the answer."""
        self._thread = Thread()
        self._ask()

    @property
    def limit_s(self) -> float:
        """Largest error of the clock by the latest answer [s]; 0: not stated."""
        return self._answer[0]

    def read(self) -> tuple[str, str, Mapping[str, float]]:
        """Return no fault, the service of the latest answer, and the limit; after 10 s, ask again without waiting."""
        limit_s, text = self._answer
        if time.monotonic() >= self._next_s and not self._thread.is_alive():
            self._thread = Thread(target=self._ask, name="host_clock", daemon=True)
            self._thread.start()
        return "", text, {"clock_limit": limit_s}

    def _ask(self) -> None:
        self._answer, self._next_s = _ask(), time.monotonic() + READ_EVERY_S


def _ask() -> tuple[float, str]:
    """Return the largest error of the clock [s] and who states it."""
    for name, (question, read) in SERVICES.items():
        if which(name) is None:
            continue
        try:
            answer = subprocess.run(question, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
            limit_s = read(answer.stdout)
        except (OSError, subprocess.TimeoutExpired, ValueError):
            limit_s = None
        if limit_s is not None:
            return limit_s, f"largest error stated by {name}"
    return 0.0, "no time service states its error; not part of the stamps' error"

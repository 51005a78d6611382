# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The record of an arm that a reloaded page finds again: its events and its history."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.numerics.stamps import NS

from posor_bringup.view_charts import NO_BAND, Chart, Series, distinct_colours
from posor_bringup.view_events import DEGRADED, EVENTS, OK, SEVERITY, Cause, EventLog, severity
from posor_bringup.view_history import History

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray

    from posor_bringup.view_geometry import DrawnArm
    from posor_bringup.view_observation import Observation

WINDOWS_S = {"30 s": 30.0, "10 min": 600.0, "1 h": 3600.0, "12 h": 43200.0}
RESTART_S = 3.0  # silence after which points belong to another run; a busy host makes shorter ones


class Since(NamedTuple):
    """Begin of a state."""

    time_ns: int
    is_first: bool  # nothing was known before


class ArmRecord:
    """What has happened to an arm.

    Attributes:
        log: Of events.
        history: Of the quantities of the charts.
        charts: Of these quantities.
        state_column: Column of the severity of the endpoint's state.

    """

    def __init__(self, joints: Sequence[str], windows_s: Sequence[float]) -> None:
        def series(names: Sequence[str], first: int, two_sigma: Sequence[int] = ()) -> list[Series]:
            colours, bands = distinct_colours(len(names)), two_sigma or [NO_BAND] * len(names)
            parts = zip(names, colours, range(first, first + len(names)), bands, strict=True)
            return [Series(*part) for part in parts]

        deviations = series("xyz", 0, (3, 4, 5))
        residuals, latencies = series(joints, 6), series(("publication", "reception"), 6 + len(joints))
        self.charts = (
            *(Chart(f"{each.label} from nominal [um], band: 2 sigma", (each,), 56) for each in deviations),
            Chart("chi-square / limit", residuals, 70, 1.0),
            Chart("latency [ms]", latencies, 50),
        )
        self.state_column = 8 + len(joints)
        self.log, self.history = EventLog(), History(self.state_column + 1, windows_s)
        self._worst = severity(OK)
        self._states = deque[tuple[int, str]](maxlen=EVENTS)
        self._identity = ""
        self._was_silent = False

    def add_state(self, time_ns: int, state: str, causes: Sequence[Cause], identity: str) -> None:
        """Add a change of the endpoint's state; ``identity``: of the arm, empty: not known."""
        self._add_state(time_ns, state, causes)
        if identity and self._identity and identity != self._identity:
            text = f"the arm has changed: identity {self._identity[:8]} became {identity[:8]}"
            self.log.note(time_ns, text)
            self.history.run += 1
        self._identity = identity or self._identity

    def _add_state(self, time_ns: int, state: str, causes: Sequence[Cause]) -> None:
        self._worst = max(self._worst, severity(state))
        self.log.update("state", time_ns, causes)
        if not self._states or _kind(self._states[-1][1]) != _kind(state):
            self._states.append((time_ns, state))

    def add(self, observation: Observation, drawn: DrawnArm | None) -> None:
        """Add an observation."""
        endpoint, time_ns = observation.endpoint, observation.time_ns
        if observation.state == "NO MESSAGE":
            return
        if not observation.is_fresh:
            self._add_state(
                time_ns if endpoint is None else endpoint.received_ns, observation.state, observation.causes
            )
            self.log.update("report", time_ns, ())
            self._was_silent = True
            return
        self.log.update("report", time_ns, observation.reports)
        if endpoint is None:
            return
        pause_s = endpoint.received_ns / NS - self.history.newest_s
        if self._was_silent and self.history.is_filled and pause_s > RESTART_S:
            self.history.run += 1
        self._was_silent = False
        # The present state holds although nothing has changed; a bag without states has no changes at all.
        self._add_state(endpoint.received_ns, observation.state, observation.causes)
        values = np.full(self.state_column + 1, np.nan)
        if drawn is not None and observation.scan is not None:
            values[:3], values[6:-3] = 1e6 * drawn.deviation[:3], observation.scan.residuals
        values[3:6] = two_sigma(endpoint.covariance)[:3] * 1e6
        values[-3:] = 1e3 * endpoint.age_s, 1e3 * endpoint.latency_s, self._worst
        self._worst = severity(observation.state)
        if not self.history.add(endpoint.received_ns / NS, values):
            self.log.note(time_ns, "the clock of this host went back: the charts begin anew")

    def since(self, time_ns: int) -> Since:
        """Return since when the endpoint is OK, usable but not OK, or unusable, as it is at a time."""
        place = max(0, bisect_right(self._states, time_ns, key=lambda each: each[0]) - 1)
        return Since(self._states[place][0] if self._states else time_ns, place == 0)


def _kind(state: str) -> int:
    """Return the kind of a state: OK, usable but not OK, or unusable."""
    return (state != OK) + (severity(state) > SEVERITY[DEGRADED])


def two_sigma(covariance: FloatArray) -> FloatArray:
    """Return two standard uncertainties along and about each axis, (6,)."""
    return np.asarray(2.0 * np.sqrt(np.diag(covariance)))


STATE_COLOURS = {
    number: {0: "#2e9643", 1: "#2e9643"}.get(number, "#da3633" if number >= SEVERITY["LOST"] else "#e39614")
    for number in range(len(SEVERITY) + 1)
}
"""Colour of the strip of states by severity: green, amber, red."""

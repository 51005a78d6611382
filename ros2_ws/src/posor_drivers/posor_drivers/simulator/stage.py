# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Micromanipulator stage at the end of the arm: moves to commanded positions at a limited speed."""

from __future__ import annotations

from collections import deque
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import PosorError
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.scenario import StageSettings


class Stage:
    """State of the stage. Times are ROS time [ns]; positions [m], (3,), axes of the endpoint.

    Commands may arrive in another thread. Each is stored with its time of arrival, so the position at a tick does not
    depend on when it is computed.
    """

    def __init__(self, settings: StageSettings, frame: str) -> None:
        """Start in the middle of the stroke; ``frame`` is the endpoint's frame, in which commands must be."""
        self._stroke, self._speed = settings.stroke.number, settings.speed.number
        self._resolution, self._max_age_s = settings.resolution.number, settings.command_age.number
        self._frame = frame
        self._position = np.zeros(3)
        self._goal = np.zeros(3)
        self._now_ns: int | None = None
        self._newest_stamp_ns: int | None = None
        self._lock = Lock()
        self._pending: deque[tuple[int, FloatArray]] = deque()

    def add_command(self, goal: FloatArray, frame: str, stamp_ns: int, now_ns: int) -> None:
        """Accept a command.

        Raises:
            PosorError: Frame, stamp or goal is invalid; the stage keeps its present goal.

        """
        where = f"stage command of {stamp_ns / NS:.6f} s"
        if frame != self._frame:
            raise PosorError(f"is in frame '{frame}'", where=where, expected=f"'{self._frame}'")
        shown = ", ".join(f"{x:g}" for x in goal)
        if not np.all(np.isfinite(goal)):
            raise PosorError(f"is ({shown}) m", where=where, expected="finite numbers")
        if np.any(np.abs(goal) > self._stroke):
            expected = f"at most {self._stroke:g} m to either side, the stroke"
            raise PosorError(f"is ({shown}) m", where=where, expected=expected)
        if abs(now_ns - stamp_ns) > self._max_age_s * NS:
            what = f"arrived at {now_ns / NS:.6f} s, {(now_ns - stamp_ns) / NS:.3g} s after its stamp"
            raise PosorError(what, where=where, expected=f"a stamp within {self._max_age_s:g} s")
        with self._lock:
            if self._newest_stamp_ns is not None and stamp_ns < self._newest_stamp_ns:
                what = f"arrived after the command of {self._newest_stamp_ns / NS:.6f} s"
                raise PosorError(what, where=where, expected="commands in the order of their stamps")
            self._newest_stamp_ns = stamp_ns
            self._pending.append((now_ns, goal))

    def restart(self) -> None:
        """Discard all commands because time has gone back; the stage keeps its position."""
        with self._lock:
            self._goal = self._position
            self._now_ns = self._newest_stamp_ns = None
            self._pending.clear()

    def position_at(self, time_ns: int) -> FloatArray:
        """Return the position at a time; times must not decrease except after ``restart``."""
        with self._lock:
            while self._pending and self._pending[0][0] <= time_ns:
                arrival_ns, goal = self._pending.popleft()
                self._advance_to(arrival_ns)
                self._goal = goal
            self._advance_to(time_ns)
            return np.asarray(self._resolution * np.round(self._position / self._resolution))

    def _advance_to(self, time_ns: int) -> None:
        if self._now_ns is not None and time_ns > self._now_ns:
            way = self._goal - self._position
            distance = float(np.linalg.norm(way))
            reach = self._speed * (time_ns - self._now_ns) / NS
            self._position = self._goal if distance <= reach else self._position + way * (reach / distance)
        self._now_ns = time_ns if self._now_ns is None else max(self._now_ns, time_ns)

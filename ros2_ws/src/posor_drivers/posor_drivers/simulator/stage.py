"""The micromanipulator stage at the end of the arm: goes where it is told, as fast as it can, step by step."""

from __future__ import annotations

from collections import deque
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.errors import PosorError

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

    from posor_drivers.simulator.scenario import StageFile

NS = 1_000_000_000


class Stage:
    """The stage's state. Times are those of the ROS clock [ns]; positions [m], (3,), axes of the endpoint.

    Commands may come in another thread. Each is kept with the time at which it came, so that the position at a tick is
    the same whenever it is asked for.
    """

    def __init__(self, said: StageFile, frame: str) -> None:
        """Put the stage in its middle.

        Args:
            said: Its limits.
            frame: The endpoint's frame, in which commands must be.

        """
        self._stroke, self._speed = said.stroke.number, said.speed.number
        self._resolution, self._age_s = said.resolution.number, said.command_age.number
        self._frame = frame
        self._position = np.zeros(3)
        self._goal = np.zeros(3)
        self._now_ns: int | None = None
        self._newest_ns: int | None = None
        self._lock = Lock()
        self._waiting: deque[tuple[int, FloatArray]] = deque()

    def command(self, goal: FloatArray, frame: str, stamp_ns: int, now_ns: int) -> None:
        """Take a command.

        Raises:
            PosorError: It is of another frame or time, or not within the stroke; the stage goes on as before.

        """
        where = f"stage command of {stamp_ns / NS:.6f} s"
        if frame != self._frame:
            raise PosorError(f"is in frame '{frame}'", where=where, expected=f"'{self._frame}'")
        if not np.all(np.isfinite(goal)):
            raise PosorError(f"is ({_shown(goal)}) m", where=where, expected="finite numbers")
        if np.any(np.abs(goal) > self._stroke):
            expected = f"at most {self._stroke:g} m to either side, the stroke"
            raise PosorError(f"is ({_shown(goal)}) m", where=where, expected=expected)
        if abs(now_ns - stamp_ns) > self._age_s * NS:
            away = (now_ns - stamp_ns) / NS
            expected = f"a stamp within {self._age_s:g} s"
            raise PosorError(
                f"came at {now_ns / NS:.6f} s, {away:.3g} s after its stamp", where=where, expected=expected
            )
        with self._lock:
            if self._newest_ns is not None and stamp_ns < self._newest_ns:
                expected = "commands in the order of their stamps"
                raise PosorError(f"came after that of {self._newest_ns / NS:.6f} s", where=where, expected=expected)
            self._newest_ns = stamp_ns
            self._waiting.append((now_ns, goal))

    def restart(self) -> None:
        """Forget all commands, since time has gone back; the stage stays where it is."""
        with self._lock:
            self._goal = self._position
            self._now_ns = self._newest_ns = None
            self._waiting.clear()

    def position_at(self, time_ns: int) -> FloatArray:
        """Return where the stage is; times must not go back but after ``restart``."""
        with self._lock:
            while self._waiting and self._waiting[0][0] <= time_ns:
                came_ns, goal = self._waiting.popleft()
                self._advance(came_ns)
                self._goal = goal
            self._advance(time_ns)
            return np.asarray(self._resolution * np.round(self._position / self._resolution))

    def _advance(self, time_ns: int) -> None:
        if self._now_ns is not None and time_ns > self._now_ns:
            way = self._goal - self._position
            distance = float(np.linalg.norm(way))
            reach = self._speed * (time_ns - self._now_ns) / NS
            self._position = self._goal if distance <= reach else self._position + way * (reach / distance)
        self._now_ns = time_ns if self._now_ns is None else max(self._now_ns, time_ns)


def _shown(position: FloatArray) -> str:
    return ", ".join(f"{x:g}" for x in position)

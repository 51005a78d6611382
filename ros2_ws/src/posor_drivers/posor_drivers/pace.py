"""How a live driver keeps pace with its ticks, as a line of its diagnostics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.moments import figures

from posor_drivers.live import Misses

if TYPE_CHECKING:
    from posor_estimator.ros.diagnostics import Status, Value
    from rclpy.impl.rcutils_logger import RcutilsLogger

    from posor_drivers.live_run import LiveRun


class Pace:
    """Tells once a second what was missed, how late ticks were begun, and whether the wall's clock was stepped."""

    def __init__(self, status: Status, logger: RcutilsLogger) -> None:
        """Follow no run yet; a step of the clock goes into the log too."""
        self._status = status
        self._logger = logger
        self._run: LiveRun | None = None
        self.restarted()

    def restarted(self) -> Misses:
        """Return the account of a new run."""
        self._misses, self._missed, self._steps = Misses(), 0, 0
        return self._misses

    def follow(self, run: LiveRun) -> None:
        """Tell of this run from now on."""
        self._run = run

    def report(self) -> None:
        """Bring the line up to date."""
        said: list[str] = []
        values: dict[str, Value] = {"ticks_missed": self._misses.ticks, "overruns": self._misses.overruns}
        if self._misses.ticks > self._missed:
            said.append("late")
            self._missed = self._misses.ticks
        beat = None if self._run is None else self._run.beat
        if beat is not None:
            due_ns, begun_ns = beat.late.take()
            values |= figures("lateness", begun_ns - due_ns)
            time = beat.time
            steps = time.steps - beat.steps_before
            values |= {"clock_steps": steps, "last_clock_step": time.step_s if steps else 0.0}
            if steps > self._steps:
                self._steps = steps
                said.append(f"the wall's clock was stepped by {time.step_s:.6g} s, ticks have begun anew")
                self._logger.warning(said[-1])
        self._status.report(Level.WARN if said else Level.OK, "; ".join(said) or "in time", values)

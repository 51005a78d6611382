"""One scan at a time from arrays to arrays: room for its readings and its results, made once and filled in place.

Nodes go from bytes to bytes (``core.records``).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import code_for
from posor_estimator.core.estimate import Estimates
from posor_estimator.core.fault import State
from posor_estimator.core.kernels.scans import locate_scans

if TYPE_CHECKING:
    from posor_estimator.core.estimate import Estimate
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.scan import Scan, Scans

LOST = int(State.LOST)


class Lane:
    """A POSOR's way for one scan at a time: the caller fills ``scans`` in place, calls ``run``, and reads the rest.

    ``Posor.locate`` goes this way too. All arrays stay the same objects from scan to scan; every number of a LOST scan
    is NaN.

    Attributes:
        scans: Raw readings, of length 1.
        pose: ``T_R_T`` as x, y, z [m] and the unit quaternion x, y, z, w, shape (7,).
        native: (x, y, gap [m], alpha, beta, theta [rad], turns counted), see ``core.native``, shape (6,).
        random: Random covariance of the pose, ROS order, see ``Estimate``, shape (6, 6).
        systematic: Systematic covariance, the same order, shape (6, 6).
        state: ``State`` of the scan, a plain number.
        faults: ``Fault`` of the scan, a plain number.
        residual: Chi-square of its redundant readings.
        redundancy: Degrees of freedom of the residual; zero of a LOST scan.

    """

    def __init__(self, posor: Posor, scans: Scans) -> None:
        """Take room for scans of the shape of ``scans`` (length 1); it becomes the room for the readings."""
        self._posor = posor
        self.scans = scans
        self._out = Estimates.room(scans.numbers, len(posor.stack.sensors), posor.redundancy)
        self._outcomes = self._out.outcomes
        self.pose, self.native = self._out.poses[0], self._out.natives[0]
        self.random, self.systematic = self._out.covariances_random[0], self._out.covariances_systematic[0]
        self._residuals = self._out.residuals
        self.state, self.faults, self.residual, self.redundancy = LOST, 0, math.nan, 0
        self._arguments = posor.loop.arguments(scans, self._out, 0, 1)
        self._locate = code_for(locate_scans, self._arguments) if posor.loop.compiled else None

    def run(self) -> int:
        """Locate the scan that stands in ``scans``, starting from the pose before; return its state."""
        outcomes = self._outcomes
        if self._locate is None:
            self._posor.loop.run(self.scans, self._out)
        else:
            stopped = self._locate(*self._arguments)
            if stopped != 1 or outcomes.item(0) == LOST:
                self._posor.loop.finish(self.scans, self._out, stopped)
        self.state, self.faults = outcomes.item(0), outcomes.item(1)
        if self.state == LOST:
            self.residual, self.redundancy = math.nan, 0
        else:
            self.residual, self.redundancy = self._residuals.item(0), self._out.redundancy
        return self.state

    def reason(self) -> str:
        """Return the sentence on what was wrong with the last scan, empty where nothing was."""
        if self.faults == 0:
            return ""
        return self._posor.reason(self.scans[0], self._out.codes[0], self.faults, self._residuals.item(0))

    def takes(self, scan: Scan) -> bool:
        """Return whether the room is of the scan's shape."""
        return (
            scan.gap_voltages.shape == self.scans.gap_voltages.shape[1:]
            and scan.ring_voltages.shape == self.scans.ring_voltages.shape[1:]
            and scan.diode_currents.shape == self.scans.diode_currents.shape[1:]
            and len(scan.lit_sources) == self.scans.lit_sources.shape[1]
        )

    def fill(self, scan: Scan) -> None:
        """Put a scan that the lane ``takes`` into ``scans``."""
        room = self.scans
        room.numbers[0], room.stamps_ns[0] = scan.number, scan.stamp_ns
        room.gap_voltages[0], room.ring_voltages[0] = scan.gap_voltages, scan.ring_voltages
        room.diode_currents[0], room.lit_sources[0] = scan.diode_currents, scan.lit_sources
        room.supply_voltages[0], room.temperatures[0] = scan.supply_voltage, scan.temperature
        room.at_home[0] = scan.at_home

    def locate(self, scan: Scan) -> Estimate:
        """Return the estimate of a scan that the lane ``takes``, in arrays of its own."""
        self.fill(scan)
        self.run()
        return self._out.one(0, self.reason())

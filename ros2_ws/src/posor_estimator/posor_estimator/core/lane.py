"""One scan at servo rate: room for its readings and its results, made once and filled in place scan after scan."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.scan import Scans


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
        residual: Chi-square of the redundant readings.
        redundancy: Its degrees of freedom; zero of a LOST scan.
        state: ``State`` of the scan, a plain number.
        faults: ``Fault`` of the scan, a plain number.

    """

    def __init__(self, posor: Posor, scans: Scans) -> None:
        """Take room for scans of the shape of ``scans`` (length 1); it becomes the room for the readings."""
        self._posor = posor
        self.scans = scans
        self.pose = np.full(7, np.nan)
        self.native = np.full(6, np.nan)
        self.random = np.full((6, 6), np.nan)
        self.systematic = np.full((6, 6), np.nan)
        self.residual = math.nan
        self.redundancy = 0
        self.state = 0
        self.faults = 0
        self._reason = ""

    def run(self) -> int:
        """Locate the scan that stands in ``scans``, starting from the pose before; return its state."""
        estimate = self._posor.locate(self.scans[0])
        self.pose[:] = np.nan if estimate.T_R_T is None else pin.SE3ToXYZQUAT(estimate.T_R_T)
        self.native[:] = estimate.native
        self.random[:, :] = estimate.covariance_random
        self.systematic[:, :] = estimate.covariance_systematic
        self.residual = estimate.residual
        self.redundancy = estimate.redundancy
        self.state = int(estimate.state)
        self.faults = int(estimate.faults)
        self._reason = estimate.reason
        return self.state

    def reason(self) -> str:
        """Return the sentence on what was wrong with the last scan, empty where nothing was."""
        return self._reason

"""How the measuring beams accelerate, from where the chain has lately found them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels import chain_motion as kernel
from posor_estimator.core.kernels.chain_motion import LEAST_SCANS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.chain import Chain, Endpoint, MeasuredJoint
    from posor_estimator.core.types import FloatArray, IntArray

__all__ = ["LEAST_SCANS", "BeamMotion", "MovingChain"]

ROOM = 256
"""Scans of the window for which there is room at first."""


class BeamMotion:
    """Fits a parabola through the beams' centres over a window of time; its curvature is the acceleration.

    What comes out belongs to the middle of the window: quasi-static, for motions slow against its length. A time that
    goes back, or on for longer than the window, begins anew. The chain's kernels work on the arrays in place.

    Attributes:
        kept: The window [ns] and the scans in it, see ``core.kernels.chain_motion``.
        seen_ns: Their times, and room for more, (room,).
        seen: The beams' centres then [m], (room, b, 3), axes of the base.

    """

    def __init__(self, window_s: float, beams: int) -> None:
        """Look back over a window [s] at so many beams; zero: look at nothing."""
        self.kept: IntArray = np.zeros(kernel.KEPT, dtype=np.int64)
        self.kept[kernel.WINDOW] = round(window_s * 1e9)
        room = ROOM if window_s else 0
        self.seen_ns: IntArray = np.zeros(room, dtype=np.int64)
        self.seen: FloatArray = np.zeros((room, beams, 3))

    @property
    def looks(self) -> bool:
        """Whether there is a window."""
        return bool(self.kept[kernel.WINDOW] > 0)

    def take(self, stamp_ns: int, centres: FloatArray) -> None:
        """Take where the beams are at a time [ns]: their centres [m], (b, 3), axes of the base."""
        kernel.begin_anew(stamp_ns, self.kept, self.seen_ns)
        if not kernel.has_room(self.kept, self.seen_ns, self.seen):
            self.make_room()
        kernel.take(stamp_ns, centres, self.kept, self.seen_ns, self.seen)

    def accelerations(self) -> FloatArray:
        """Return each beam's acceleration [m/s^2], (b, 3), axes of the base; zero while scans are too few."""
        found = np.zeros(self.seen.shape[1:])
        kernel.accelerations(self.kept, self.seen_ns, self.seen, found)
        return found

    def make_room(self) -> None:
        """Make room for twice as many scans; the arrays are others then."""
        self.seen_ns = np.concatenate([self.seen_ns, np.zeros_like(self.seen_ns)])
        self.seen = np.concatenate([self.seen, np.zeros_like(self.seen)])

    def forget(self) -> None:
        """Begin anew."""
        self.kept[kernel.BEGIN] = self.kept[kernel.END] = 0


class MovingChain:
    """A chain, scan after scan: each endpoint is found with the accelerations that the scans before it tell of."""

    def __init__(self, chain: Chain, window_s: float) -> None:
        """Find accelerations over a window [s]; 0: none, as if at rest."""
        self._lane = chain.lane(window_s)

    def endpoint(self, stamp_ns: int, measured: Mapping[str, MeasuredJoint]) -> Endpoint:
        """Return the endpoint of the scan at a time [ns]; a time that goes back begins anew."""
        from posor_estimator.core.chain import run_lane  # noqa: PLC0415  the chain needs this module

        return run_lane(self._lane, measured, stamp_ns)

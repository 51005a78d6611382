"""How the measuring beams accelerate, from where the chain has lately found them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels import chain_motion as kernel

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

ROOM = 256
"""Scans of the window for which there is room at first."""


class BeamMotion:
    """Where the beams were over a window of time; the kernels fit a parabola to it, its curvature is the acceleration.

    What comes out belongs to the middle of the window: quasi-static, for motions slow against its length. A time that
    goes back, or on for longer than the window, begins anew.

    Attributes:
        kept: The window [ns] and the scans in it, see ``core.kernels.chain_motion``.
        seen_ns: Their times, and room for more, (room,).
        seen: The beams' centres then [m], (room, 3 b), axes of the base.

    """

    def __init__(self, window_s: float, beams: int) -> None:
        """Look back over a window [s] at so many beams; zero: look at nothing."""
        self.kept: IntArray = np.zeros(kernel.KEPT, dtype=np.int64)
        self.kept[kernel.WINDOW] = round(window_s * 1e9)
        room = ROOM if window_s else 0
        self.seen_ns: IntArray = np.zeros(room, dtype=np.int64)
        self.seen: FloatArray = np.zeros((room, 3 * beams))

    @property
    def looks(self) -> bool:
        """Whether there is a window."""
        return bool(self.kept[kernel.WINDOW] > 0)

    def make_room(self) -> None:
        """Make room for twice as many scans; the arrays are others then."""
        self.seen_ns = np.concatenate([self.seen_ns, np.zeros_like(self.seen_ns)])
        self.seen = np.concatenate([self.seen, np.zeros_like(self.seen)])

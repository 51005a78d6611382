"""How the measuring beams accelerate, from where the chain has lately found them."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.chain import Chain, Endpoint, MeasuredJoint
    from posor_estimator.core.types import FloatArray

LEAST_SCANS = 5
"""Fewer scans say more of the readings' noise than of an acceleration."""


class BeamMotion:
    """Fits a parabola through the beams' centres over a window of time; its curvature is the acceleration.

    What comes out belongs to the middle of the window: quasi-static, for motions slow against its length.
    """

    def __init__(self, window_s: float) -> None:
        """Look back over a window [s]."""
        self._window_ns = round(window_s * 1e9)
        self._seen: deque[tuple[int, FloatArray]] = deque()
        self._names: tuple[str, ...] = ()

    def take(self, stamp_ns: int, centres: Mapping[str, FloatArray]) -> None:
        """Take where the beams are at a time [ns]; a time that goes back begins anew."""
        self._names = tuple(centres)
        if self._seen and stamp_ns <= self._seen[-1][0]:
            self._seen.clear()
        self._seen.append((stamp_ns, np.concatenate([np.zeros(0), *centres.values()])))
        while stamp_ns - self._seen[0][0] > self._window_ns:
            self._seen.popleft()

    def accelerations(self) -> dict[str, FloatArray]:
        """Return each beam's acceleration [m/s^2], (3,), axes of the base; none while scans are too few."""
        if len(self._seen) < LEAST_SCANS:
            return {}
        last_ns = self._seen[-1][0]
        times = np.array([(stamp_ns - last_ns) * 1e-9 for stamp_ns, _ in self._seen])
        curvature = 2.0 * polynomial.polyfit(times, np.array([centres for _, centres in self._seen]), 2)[2]
        return dict(zip(self._names, curvature.reshape(-1, 3), strict=True))


class MovingChain:
    """A chain, scan after scan: each endpoint is found with the accelerations that the scans before it tell of."""

    def __init__(self, chain: Chain, window_s: float) -> None:
        """Find accelerations over a window [s]; 0: none, as if at rest."""
        self._chain = chain
        self._motion = BeamMotion(window_s) if window_s else None

    def endpoint(self, stamp_ns: int, measured: Mapping[str, MeasuredJoint]) -> Endpoint:
        """Return the endpoint of the scan at a time [ns]; a time that goes back begins anew."""
        if self._motion is None:
            return self._chain.endpoint(measured)
        endpoint = self._chain.endpoint(measured, self._motion.accelerations())
        self._motion.take(stamp_ns, self._chain.beam_centres())
        return endpoint

"""The measuring beams as they are: not quite as the beams file says, and sagging."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_drivers.simulator.poses import Poses
from posor_drivers.simulator.randomness import Stream

if TYPE_CHECKING:
    from posor_estimator.core.chain import FixedLink
    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class TrueBeam:
    """One beam from target plate to receiving plate; where the beams file names none, straight and exact.

    Attributes:
        before: From the target plate to the beam's start.
        end: From the beam's start to its end, without sag.
        after: From the beam's end to the next receiving plate, or to the endpoint.
        start_gain: Small motion of the plate at the start for a specific force, axes of the start, (6, 3), see
            ``MeasuringBeam``.
        end_gain: The same of the plate at the end.

    """

    before: pin.SE3
    end: pin.SE3
    after: pin.SE3
    start_gain: FloatArray
    end_gain: FloatArray

    @classmethod
    def of(cls, link: FixedLink, seed: int, *, errors: bool, sag: bool) -> TrueBeam:
        """Return the real beam of a link.

        Args:
            link: The link as the chain knows it.
            seed: Of the scenario.
            errors: Whether the beam and its sag differ from what is known, by as much as is said to be uncertain.
            sag: Whether it sags.

        """
        beam, none = link.beam, np.zeros((6, 3))
        if beam is None:
            return cls(link.before, pin.SE3.Identity(), link.after, none, none)
        random = Stream(seed, "beam", beam.name).at()
        off = np.sqrt(np.diagonal(beam.covariance)) * random.normal(size=6)
        scale = 1.0 + beam.sag_sigma * float(random.normal())
        end = beam.T_start_end
        if errors:
            end = pin.SE3(pin.exp3(off[3:]) @ end.rotation, end.translation + off[:3])
        factor = (scale if errors else 1.0) if sag else 0.0
        return cls(link.before, end, link.after, factor * beam.start_gain, factor * beam.end_gain)

    def plates(self, lines: Poses, specific_force: FloatArray) -> tuple[Poses, Poses]:
        """Return the target plate at the start and the receiving plate at the end.

        Args:
            lines: The beam's line through its gimbals, (n): where the target plate would be without sag.
            specific_force: Gravity less acceleration [m/s^2], (3,) or (n, 3), in the frame that the poses are in.

        """
        start = lines @ self.before
        force = start.turned_back(specific_force)
        return (
            start @ _small(force @ self.start_gain.T) @ self.before.inverse(),
            start @ Poses.repeated(self.end, len(start)).moved(*np.hsplit(force @ self.end_gain.T, 2)) @ self.after,
        )


def _small(motions: FloatArray) -> Poses:
    """Return the poses of small motions (n, 6), translation first."""
    return Poses.motions(*np.hsplit(motions, 2))

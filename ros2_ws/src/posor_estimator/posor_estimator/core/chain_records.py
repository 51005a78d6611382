"""A chain's lane whose joints' measurements come as rows of bytes: messages that are not taken apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import code_for
from posor_estimator.core.kernels import chain_records as kernel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.chain_lane import ChainLane
    from posor_estimator.core.types import ByteArray, FloatArray, IntArray


@dataclass(frozen=True)
class JointColumns:
    """Where a row with a joint's measurement has what: offsets in bytes, of numbers at multiples of their size.

    Attributes:
        pose: x, y, z [m] and the quaternion x, y, z, w, floats of eight bytes.
        theta: The large rotation, counted [rad], likewise.
        covariance: Row by row, likewise.
        state: ``State``, one byte.
        size: Of the row.

    """

    pose: int
    theta: int
    covariance: int
    state: int
    size: int

    @property
    def array(self) -> IntArray:
        """What the kernels work by, shape (4,).

        Raises:
            ValueError: A number does not lie at a multiple of its size.

        """
        if any(offset % 8 for offset in (self.pose, self.theta, self.covariance)):
            message = "a number does not lie at a multiple of its size"
            raise ValueError(message)
        return np.array([self.pose // 8, self.theta // 8, self.covariance // 8, self.state])


def read_records(
    rows: ByteArray, columns: JointColumns, joint: int, poses: FloatArray, covariances: FloatArray, thetas: FloatArray
) -> None:
    """Write many measurements of one joint (n, bytes) where ``ChainLane.endpoints`` takes them; others as there."""
    kernel.read_records(rows.view(np.float64), columns.array, joint, poses, covariances, thetas)


class ChainRecords:
    """Puts rows of measurements into a lane and runs it.

    Attributes:
        rows: Room for those of one scan, to be filled in place, shape (joints, bytes).

    """

    def __init__(self, lane: ChainLane, columns: Sequence[JointColumns]) -> None:
        """Prepare for the lane's joints, in their order."""
        self._lane = lane
        width = max(-(-each.size // 8) for each in columns)
        floats = np.zeros((len(columns), width))
        self.rows: ByteArray = floats.view(np.uint8)
        self._rows = np.stack([each.array for each in columns]), floats, self.rows
        self._take_arguments()
        self._run = code_for(kernel.endpoint_of_records, self._arguments)

    def run(self, stamp_ns: int) -> int:
        """Find the endpoint of the rows; return the worst state of its joints, negative where there is no endpoint."""
        lane = self._lane
        lane.stamp_ns[0] = stamp_ns
        while True:
            if lane.arguments is not self._of_lane:  # somebody has made room
                self._take_arguments()
            worst = self._run(*self._arguments)
            if worst != kernel.NO_ROOM:
                return worst
            lane.make_room()

    def _take_arguments(self) -> None:
        self._of_lane = self._lane.arguments
        self._arguments = *self._rows, *self._of_lane

"""An arm laid out for the compiled walk: what lies on the way from the base to the endpoint, in plain arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor_estimator.core.kernels.chain import BEAM_ROWS, END_GAIN, SAG_GAIN, SHIFT_GAIN, SPAN, START_GAIN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.measuring_beam import MeasuringBeam
    from posor_estimator.core.robot_model import RobotModel
    from posor_estimator.core.types import FloatArray, IntArray


class ChainLayout(NamedTuple):
    """An arm as the kernels want it; every array is described in ``core.kernels.chain``."""

    sources: IntArray
    frames: FloatArray
    beams: FloatArray
    beam_covariances: FloatArray
    origins: FloatArray
    gravity: FloatArray

    @classmethod
    def of(cls, robot: RobotModel, beams: Sequence[MeasuringBeam], gravity: FloatArray) -> ChainLayout:
        """Lay out an arm.

        Args:
            robot: Its URDF.
            beams: Its measuring beams, in the order of the joints ``robot`` has freed for them.
            gravity: [m/s^2], (3,), axes of the base.

        """
        joints = (*robot.joints, *robot.freed)
        by_index = {joint.index: joint for joint in joints}
        numbers = {joint.index: number for number, joint in enumerate(robot.joints)}
        numbers |= {joint.index: -1 - number for number, joint in enumerate(robot.freed)}
        path = robot.path()
        fixed = [*(by_index[index].T_before_parent for index in path), robot.T_joint_endpoint]
        return cls(
            np.array([numbers[index] for index in path], dtype=np.int64),
            np.array([[*each.rotation, each.translation] for each in fixed]),
            np.reshape([_rows(beam) for beam in beams], (len(beams), BEAM_ROWS, 3)).astype(float),
            np.reshape([beam.covariance for beam in beams], (len(beams), 6, 6)).astype(float),
            np.array([joint.T_parent_joint.rotation for joint in robot.joints]),
            np.array(gravity, dtype=float),
        )


def _rows(beam: MeasuringBeam) -> FloatArray:
    """Return what the kernels have to know of a beam, (BEAM_ROWS, 3)."""
    rows = np.empty((BEAM_ROWS, 3))
    span = beam.T_start_end
    rows[SPAN : SPAN + 3], rows[SPAN + 3] = span.rotation, span.translation
    rows[SHIFT_GAIN : SHIFT_GAIN + 3] = beam.end_gain[:3] - beam.start_gain[:3]
    rows[START_GAIN : START_GAIN + 3] = beam.start_gain[3:]
    rows[END_GAIN : END_GAIN + 3] = span.rotation.T @ beam.end_gain[3:]
    rows[SAG_GAIN:] = beam.sag_sigma * beam.sag_gain
    return rows

"""The motion tests of 1985 without nodes: the estimator over the recorded bag, the same numbers as in a replay."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.bags.calibration_recording import Reference, load_recording
from posor.bags.recording import POINT
from posor.calibration.calibration_file import load_calibration
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, Fault, State
from posor.ros_names import TRUTH_TOPIC
from posor_bringup.installed import JOINT, bag_path, calibration_path, urdf_path

from posor_lab.replay_1985.motion_test import MotionStep, MotionTest

if TYPE_CHECKING:
    from posor_bringup.installed import Bag, CalibrationName

_ENDPOINT = "endpoint"


@cache
def offline_motion_test(bag: Bag, calibration: CalibrationName) -> MotionTest:
    """Return a motion test as a replay of its bag gives it.

    Raises:
        PosorError: A file of the rig is missing or invalid.

    """
    recording = load_recording(bag_path(bag), references=[Reference(TRUTH_TOPIC)])
    estimates = Posor(load_calibration(calibration_path(calibration)).for_session(bag)).estimate_all(recording.scans)
    chain = load_chain(urdf_path(), _ENDPOINT)
    truths = recording.find_track(TRUTH_TOPIC, POINT).interpolate(recording.scans.stamps_ns, 0)
    steps = []
    for n, number in enumerate(recording.scans.numbers):
        state = State(int(estimates.states[n]))
        endpoint = np.full(3, np.nan)
        if state in USABLE_STATES:
            pose = pin.SE3(estimates.rotations[n], estimates.translations[n])
            endpoint = chain.estimate({JOINT: MeasuredJoint(pose, np.zeros((6, 6)))}).T_base_endpoint.translation
        steps.append(
            MotionStep(
                number=int(number),
                state=state,
                faults=Fault(int(estimates.faults[n])),
                scan_status=0 if recording.statuses is None else int(recording.statuses[n]),
                angles=estimates.natives[n, 3:],
                truth=truths[n],
                endpoint=endpoint,
            )
        )
    return MotionTest(tuple(steps))

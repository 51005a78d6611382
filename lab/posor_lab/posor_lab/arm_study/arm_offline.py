"""The endpoint of an arm from raw scan messages, without any node: the offline pipeline's numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.bags.arm_estimator import ArmEstimator
from posor.bags.reprocess_task import Settings
from posor.messages.raw_scan import RecordedScans
from posor.model.scan import Scans
from posor_ros.message_conversion import scan_from_message

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.arm_file import Arm
    from posor.messages.estimate_arrays import EndpointEstimates
    from posor_msgs.msg import RawScan


def arm_endpoints(arm: Arm, scans: Mapping[str, Sequence[RawScan]]) -> EndpointEstimates:
    """Return the endpoint at every stamp for which a chain_node has one, in order.

    Args:
        arm: The arm.
        scans: Of every joint, in the order of their stamps, all with the same readings.

    Raises:
        CalibrationError: A calibration or the beams file is invalid.
        ChainError: The URDF is invalid.
        NodeError: The arm file gives chain_node an invalid parameter.

    """
    estimator = ArmEstimator(Settings.of_arm(arm))
    return estimator.estimate_block({joint: [_recorded_scans(each)] for joint, each in scans.items()}).endpoint


def _recorded_scans(messages: Sequence[RawScan]) -> RecordedScans:
    scans = Scans.of([scan_from_message(message) for message in messages])
    stamps = [(message.header.stamp.sec, message.header.stamp.nanosec) for message in messages]
    return RecordedScans(
        log_times_ns=scans.stamps_ns,
        order=np.arange(len(messages)),
        scans=scans,
        header_stamps=np.array(stamps, dtype=np.int64),
        statuses=np.array([message.status for message in messages], dtype=np.int64),
        frame=messages[0].header.frame_id,
    )

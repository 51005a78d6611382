# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make the bag that the live page replays: transforms and states of an arm with faults, eight scans a second.

``make data`` runs it in the environment of the workspace; an optional argument is the output folder. The simulated arm
``five_axis_checked`` runs through one cycle at the rate of its scenario; the numerical core estimates every scan, as
the nodes do, and every 25th is kept. The transforms state no causes of faults, which would make the bag ten times
as large. Every run gives the same bytes.
"""

from __future__ import annotations

import sys
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.bags.arm_estimator import ArmEstimator
from posor.bags.bag_writer import replace_bag
from posor.bags.reprocess_task import Settings
from posor.chain.fault_bounds import EndpointBounds
from posor.errors import PosorError
from posor.estimation.fault_model import EFFECT, JointCauses
from posor.messages.estimate_arrays import ArmEstimates
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import tick_stamp_ns
from posor.ros_names import JOINT_STATE
from posor_bringup.arms import load_checked_arm
from posor_bringup.view_recording import Recording
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.faults import SimulatedFault
from posor_lab.harness.beams import quantity
from posor_lab.harness.message_conversion import recorded_scans
from posor_msgs.msg import RawScan
from posor_ros.qos import RELIABLE_QOS
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from posor.estimation.estimate import Estimates

HERE = Path(__file__).resolve().parent
ARM = "five_axis_checked"
START_S = 1_767_225_600
"""2026-01-01 00:00:00 UTC, the beginning of a cycle of the scenario."""
JOINTS = ("base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw")
EVERY = 25  # scans, of which one is kept
FAULTS = (  # joint, kind, channel, begin and end [s], volts; of all joints: a supply voltage above its range
    ("elbow", "nan", "gap_1", 2.0, 3.4, None),
    ("wrist_roll", "off", None, 6.0, 7.0, None),
    *((joint, "supply", None, 8.0, 10.0, 16.0) for joint in JOINTS),
)


def simulated_fault(
    joint: str, kind: str, channel: str | None, begin_s: float, end_s: float, volts: float | None
) -> SimulatedFault:
    """Return a fault of the simulator."""
    entry: dict[str, object] = {"joint": joint, "kind": kind, "channel": channel}
    entry |= {"from": quantity(begin_s, "s"), "until": quantity(end_s, "s")}
    return SimulatedFault.model_validate(entry | ({} if volts is None else {"size": quantity(volts, "V")}))


def without_effects(estimates: Estimates) -> Estimates:
    """Return estimates without what causes of faults may do to them."""
    others = copy(estimates)
    others.fault_effects = np.zeros((len(estimates), 0, EFFECT), dtype=np.float32)
    return others


def main(folder: Path) -> None:
    """Make the bag in ``folder``."""
    arm, types = load_checked_arm(ARM), MessageTypes()
    simulation = ArmSimulation(arm).with_faults([simulated_fault(*fault) for fault in FAULTS])
    make, rate = SimulatedMessages(types, simulation), simulation.scenario.ticks_per_second
    ticks = START_S * rate + np.arange(simulation.scenario.cycle_ticks)
    scans = {}
    for joint in simulation.joints:
        each = simulation.scans(joint, ticks)
        messages = (make.raw_scan(joint, each, n) for n in np.flatnonzero(each.sent).tolist())
        scans[joint] = [recorded_scans([deserialize_message(message.data, RawScan) for message in messages])]
    estimator = ArmEstimator(Settings.of_arm(arm))
    estimates = estimator.estimate_block(scans)
    kept = {tick_stamp_ns(tick, rate): n for n, tick in enumerate(ticks.tolist()) if n % EVERY == 0}
    endpoint = estimates.endpoint
    which = np.isin(endpoint.stamps_ns, list(kept))
    joints = {name: each.select(np.isin(each.stamps_ns, list(kept))) for name, each in estimates.joints.items()}
    thinned = ArmEstimates(
        {name: without_effects(each) for name, each in joints.items()}, endpoint.select(which), estimates.chain
    )
    transforms = {name: each._replace(causes=JointCauses()) for name, each in estimator.transforms.items()}
    with replace_bag(folder / ARM) as writer:
        recording = Recording(writer, arm, estimator, transforms)
        bounds = recording.endpoint.bounds
        recording.write(thinned, EndpointBounds(bounds.levels[which], bounds.joints[which], bounds.causes[which]))
        recording.finish()
        encoders = make.topics.encoders
        writer.add_topic(encoders.name, JOINT_STATE, types.definition(JOINT_STATE), [RELIABLE_QOS])
        truth = simulation.truth(ticks)
        for time_ns, n in kept.items():
            writer.write(encoders.name, time_ns, make.arm_truth(time_ns, truth, n)[-1].data)
    print(f"made {folder / ARM}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
    except PosorError as error:
        sys.exit(str(error))

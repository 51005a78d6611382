# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Subscription of posor_node to an encoder of its joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.errors import PosorError, TopicError
from posor.messages.joint_position import joint_position
from posor.numerics.stamps import time_ns
from posor_ros.qos import input_qos
from sensor_msgs.msg import JointState

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.node_parameters import PosorParameters
    from posor_ros.freshness import InputMonitor
    from posor_ros.lifecycle_node import PosorNode


def subscribe_to_encoder(
    node: PosorNode[PosorParameters], inputs: InputMonitor, confirm: Callable[[float, int], None]
) -> None:
    """Pass each position of the encoder [rad] and its stamp [ns] to ``confirm``.

    ``inputs`` reports a message that cannot be used.
    """

    def on_message(message: JointState) -> None:
        if not node.may_publish:
            return
        encoder, stamp = node.parameters.encoder, message.header.stamp
        try:
            theta = joint_position(message.name, message.position, encoder.joint)
            stamp_ns = time_ns(stamp.sec, stamp.nanosec)
            if fault := inputs.stamp_limits.fault(stamp_ns):
                raise TopicError(fault)
            confirm(theta, stamp_ns)
        except PosorError as error:
            inputs.note("encoder", f"{encoder.topic}: {error}")

    topic = node.parameters.encoder.topic
    subscription = node.create_subscription(JointState, topic, on_message, input_qos(node.parameters))
    node.add_cleanup(node.destroy_subscription, subscription)

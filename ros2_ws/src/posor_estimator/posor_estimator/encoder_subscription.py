# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Subscription of posor_node to an encoder of its joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.errors import PosorError, TopicError
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
            theta = encoder_position(message, encoder.joint)
            stamp_ns = time_ns(stamp.sec, stamp.nanosec)
            if fault := inputs.stamp_limits.fault(stamp_ns):
                raise TopicError(fault)
            confirm(theta, stamp_ns)
        except PosorError as error:
            inputs.note("encoder", f"{encoder.topic}: {error}")

    topic = node.parameters.encoder.topic
    subscription = node.create_subscription(JointState, topic, on_message, input_qos(node.parameters))
    node.add_cleanup(node.destroy_subscription, subscription)


def encoder_position(message: JointState, joint: str) -> float:
    """Return the position of a joint [rad], without a name that of the only one.

    Raises TopicError: the message does not hold the position.
    """
    names = list(message.name)
    if joint and joint not in names:
        raise TopicError(f"no joint '{joint}' among {', '.join(names)}")
    if not joint and len(message.position) != 1:
        raise TopicError(f"{len(message.position)} positions", expected="one, or the parameter 'encoder.joint'")
    index = names.index(joint) if joint else 0
    if index >= len(message.position):
        raise TopicError(f"no position of joint '{joint}'")
    return float(message.position[index])

"""Receives the endpoint's poses in a process of its own and notes when: ``receiver.py TOPIC FILE``.

The messages stay bytes; of each the stamp, the publication's time and number and the time of reception are kept. Ends
on SIGINT and then writes them as an array (n, 4) of integers: stamp, published, received [ns], number.
"""

from __future__ import annotations

import gc
import sys
from array import array
from struct import Struct
from time import time_ns
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from posor_estimator.ros.main import StopSignal, own_arguments
from rclpy.impl.implementation_singleton import rclpy_implementation as implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

if TYPE_CHECKING:
    from collections.abc import Iterator

READY, FIRST = "listening", "receiving"
"""What it prints when it has subscribed, and when the first pose has come."""
COLUMNS = 4
DEPTH = 1000
LOOKOUT_NS = 100_000_000
_STAMP = Struct("<iI")
_NS = 1_000_000_000


class Receiver:
    """A subscription that is waited for and emptied without an executor: that also gives the publication's number."""

    def __init__(self, topic: str) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("bench_receiver", enable_rosout=False, start_parameter_services=False)
        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._subscription = self._node.create_subscription(PoseStamped, topic, _never_called, qos, raw=True)
        self.noted = array("q")

    def receive(self, stop: StopSignal) -> None:
        """Note all that comes until asked to stop."""
        handle: Any = self._subscription.handle
        context: Any = self._node.context.handle
        with handle, context:
            wait_set = implementation.WaitSet(1, 0, 0, 0, 0, 0, context)
            while not stop.requested:
                wait_set.clear_entities()
                wait_set.add_subscription(handle)
                wait_set.wait(LOOKOUT_NS)
                for data, info in self._taken(handle):
                    now_ns = time_ns()
                    sec, nanosec = _STAMP.unpack_from(data, 4)
                    if not self.noted:
                        print(FIRST, flush=True)
                    self.noted.extend(
                        (sec * _NS + nanosec, info["source_timestamp"], now_ns, info["publication_sequence_number"])
                    )

    @staticmethod
    def _taken(handle: Any) -> Iterator[tuple[bytes, dict[str, int]]]:
        while (taken := handle.take_message(PoseStamped, True)) is not None:  # noqa: FBT003  raw; rclpy's signature
            yield taken

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        try_shutdown()


def _never_called(_data: bytes) -> None:
    """Stand where rclpy wants a callback."""


def main() -> None:
    """Run the program."""
    topic, file = own_arguments(sys.argv)
    stop = StopSignal()
    receiver = Receiver(topic)
    gc.disable()
    print(READY, flush=True)
    receiver.receive(stop)
    receiver.close()
    np.save(file, np.array(receiver.noted, dtype=np.int64).reshape(-1, COLUMNS))


if __name__ == "__main__":
    main()

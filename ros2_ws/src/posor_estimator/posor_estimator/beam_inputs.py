# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Topics of the thermometers and accelerometers of an arm, and the beams that follow their readings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from posor.chain.beam_temperatures import BeamTemperatures
from posor.chain.beam_vibration import BeamVibrations
from posor.errors import TopicError
from posor.numerics.stamps import time_ns
from posor_ros.intra_process import IntraProcessSubscription
from posor_ros.qos import input_qos
from sensor_msgs.msg import Imu, Temperature

from posor_estimator.acceleration_reader import AccelerationReader

if TYPE_CHECKING:
    from threading import RLock

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.kinematic_chain import Chain
    from posor.node_parameters import ChainParameters
    from posor_ros.lifecycle_node import PosorNode
    from rclpy.subscription import Subscription


class BeamInputs:
    """Receives the readings that the beams file names, and brings the beams of an estimator to them.

    Attributes:
        temperatures: Of beams and plates.
        vibrates: Whether accelerometers are named; their beams move with every scan.

    """

    def __init__(
        self, node: PosorNode[ChainParameters], chain: Chain, estimator: EndpointEstimator, lock: RLock
    ) -> None:
        """Subscribe; ``lock`` protects the estimator. Updates and restarts are called under it."""
        parameters, self._lock = node.parameters, lock
        self.temperatures = BeamTemperatures(chain.beams, estimator, chain.plates)
        self._vibrations = BeamVibrations(chain.beams, estimator)
        self.vibrates = bool(self._vibrations.names)
        self._thermometers: dict[str, Subscription] = {}
        self._accelerometers: dict[str, IntraProcessSubscription] = {}
        qos = input_qos(parameters)
        for name in self.temperatures.names:
            topic, callback = f"{parameters.temperature_topic}/{name}", partial(self._on_temperature, name)
            self._thermometers[name] = node.create_subscription(Temperature, topic, callback, qos)
            node.add_cleanup(node.destroy_subscription, self._thermometers[name])
        for name in self._vibrations.names:
            topic, read = f"{parameters.acceleration_topic}/{name}", partial(self._on_acceleration, name)
            callback = partial(read, AccelerationReader())
            self._accelerometers[name] = IntraProcessSubscription(node, Imu, topic, qos, callback)

    @property
    def reason(self) -> str:
        """What is wrong with thermometers and accelerometers, as a sentence; empty: nothing."""
        return "; ".join(filter(None, (self.temperatures.reason, self._vibrations.reason)))

    def restart(self) -> None:
        """Forget all readings."""
        self.temperatures.restart()
        self._vibrations.restart()

    def update(self, stamp_ns: int) -> None:
        """Bring the beams to their temperatures and vibrations at the stamp of a scan [ns]."""
        if self.temperatures.names:
            self.temperatures.update(stamp_ns)
        if self.vibrates:
            self._vibrations.update(stamp_ns)

    def _on_temperature(self, name: str, message: Temperature) -> None:
        """Add a reading of a thermometer; the scans that follow check and use it."""
        stamp_ns = time_ns(message.header.stamp.sec, message.header.stamp.nanosec)
        publishers = self._thermometers[name].get_publisher_count()
        with self._lock:
            self.temperatures.add(name, stamp_ns, message.temperature, message.header.frame_id, publishers)

    def _on_acceleration(self, name: str, reader: AccelerationReader, data: bytes) -> None:
        """Add a reading of an accelerometer; the scans that follow check and use it."""
        publishers = self._accelerometers[name].publishers
        with self._lock:
            if publishers > 1:
                self._vibrations.refuse(name, f"has {publishers} publishers on its topic; expected one")
                return
            try:
                stamp_ns, reading, frame = reader.read(data)
            except TopicError as error:
                self._vibrations.refuse(name, f"has sent an invalid message: {str(error).rstrip('.')}")
                return
            self._vibrations.add(name, stamp_ns, reading, frame)

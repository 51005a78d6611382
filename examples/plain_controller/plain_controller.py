# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Keeps an endpoint at its target by a stage: python plain_controller.py --ros-args -r __ns:=/five_axis"""

import signal

import rclpy
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from posor_msgs.msg import EndpointState
from rclpy.node import Node

MAX_AGE_S, KEPT, SILENT = 0.1, 100, "no message on endpoint/state"


class PlainController(Node):
    def __init__(self):
        super().__init__("plain_controller")
        self.targets, self.positions, self.reason = {}, {}, SILENT
        self.output = self.create_publisher(Vector3Stamped, "stage/command", 10)
        self.create_subscription(PoseStamped, "target/endpoint", lambda target: self.keep(self.targets, target), 10)
        self.create_subscription(Vector3Stamped, "stage/position", lambda stage: self.keep(self.positions, stage), 10)
        self.create_subscription(EndpointState, "endpoint/state", self.on_state, 10)
        self.watchdog = self.create_timer(MAX_AGE_S, self.stop)  # one scan without a pose is no reason to stop

    def keep(self, messages, message):
        messages[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec] = message
        if len(messages) > KEPT:
            del messages[next(iter(messages))]

    def on_state(self, message):
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        age_s = (self.get_clock().now().nanoseconds - stamp) * 1e-9
        usable = message.state == EndpointState.STATE_OK and abs(age_s) <= MAX_AGE_S
        self.reason = "nothing to command" if usable else message.reason or f"state {message.state}, {age_s:.3f} s old"
        if usable and stamp in self.targets and stamp in self.positions:
            self.command(message.pose, self.targets[stamp].pose.position, self.positions[stamp])

    def command(self, measured, target, stage):  # R^T (target - measured) + stage would have removed the error
        p, q, command = measured.position, measured.orientation, Vector3Stamped(header=stage.header)
        x, y, z = target.x - p.x, target.y - p.y, target.z - p.z
        a, b, c = y * q.z - z * q.y, z * q.x - x * q.z, x * q.y - y * q.x  # (x, y, z) x (q.x, q.y, q.z)
        command.vector.x = x + 2.0 * (q.w * a + b * q.z - c * q.y) + stage.vector.x
        command.vector.y = y + 2.0 * (q.w * b + c * q.x - a * q.z) + stage.vector.y
        command.vector.z = z + 2.0 * (q.w * c + a * q.y - b * q.x) + stage.vector.z
        if abs(command.vector.x + command.vector.y + command.vector.z) < float("inf"):  # nor is NaN
            self.output.publish(command)
            self.watchdog.reset()

    def stop(self):  # another machine would brake here
        self.get_logger().warning(f"stopped: {self.reason}", throttle_duration_sec=1.0)
        self.reason = SILENT


if __name__ == "__main__":
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)  # its own ends a context in use
    done, controller = rclpy.Future(), PlainController()
    for each in signal.SIGINT, signal.SIGTERM:
        signal.signal(each, lambda *_: done.set_result(None))
    rclpy.spin_until_future_complete(controller, done)  # the watchdog wakes it
    rclpy.get_global_executor().shutdown()  # before the node that it waits for
    controller.destroy_node()  # the end of the interpreter destroys in any order
    rclpy.shutdown()

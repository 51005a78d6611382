# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Releases a joint that a fault has latched: ``python acknowledge.py /six_axis/elbow "lens of diode 2 cleaned"``."""

import getpass
import sys
from typing import Any

import rclpy
from posor_msgs.srv import Acknowledge

if len(sys.argv) != 3:
    sys.exit("usage: acknowledge.py /ARM/JOINT REASON")
rclpy.init()
node = rclpy.create_node("acknowledge")
client: Any = node.create_client(Acknowledge, f"{sys.argv[1]}/posor_node/acknowledge")
if not client.wait_for_service(5.0):
    sys.exit(f"no service {client.srv_name} within 5 s; expected a posor_node with 'allow_changes'")
answer: Any = client.call_async(Acknowledge.Request(caller=getpass.getuser(), reason=sys.argv[2]))
rclpy.spin_until_future_complete(node, answer, timeout_sec=5.0)
if not answer.done():
    sys.exit(f"no answer of {client.srv_name} within 5 s")
print(answer.result().message)
sys.exit(0 if answer.result().success else 1)

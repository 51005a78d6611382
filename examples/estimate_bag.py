# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimates the endpoint of a recorded arm without ROS; run it from the repository root."""

from posor import load_arm

arm = load_arm("ros2_ws/src/posor_bringup/arms/five_axis/arm.yaml")
endpoint = arm.estimate("bags/five_axis").endpoint
for stamp, pose, sigma in zip(endpoint.stamps_ns, endpoint.poses, endpoint.standard_uncertainties, strict=True):
    position = ", ".join(f"{value:.9f} m ± {1e6 * u:.2f} um" for value, u in zip(pose[:3], sigma[:3], strict=True))
    rotation = ", ".join(f"{1e6 * u:.2f}" for u in sigma[3:])
    print(f"{stamp} ns: {position}; rotation ± {rotation} urad")

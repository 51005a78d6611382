# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The six-axis arm with swinging joints, and comparison of arrays bit by bit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
from posor.chain.arm_file import load_arm_file
from posor.chain.kinematic_chain import Chain
from posor.numerics.array_types import FloatArray, IntArray

FOLDER = Path(__file__).resolve().parents[3] / "posor_bringup" / "arms" / "six_axis"
JOINTS = 6
SCANS = 40
PERIOD_NS = 500_000
WINDOW_S = 0.01  # of the scans here, 20 periods


def six_axis_chain() -> Chain:
    return load_arm_file(FOLDER / "arm.yaml").chain()


def swinging(chain: Chain, scans: int) -> tuple[FloatArray, IntArray]:
    """Return poses of joints that swing at 3 Hz and more, and the stamps."""
    stamps = np.arange(1, scans + 1) * PERIOD_NS
    angles = 0.3 * np.sin(stamps[:, None] * 1e-9 * 2.0 * math.pi * np.linspace(3.0, 5.0, JOINTS))
    names = [joint.name for joint in chain.joints]
    return (
        np.array(
            [[pin.SE3ToXYZQUAT(chain.nominal_joint(n, a)) for n, a in zip(names, row, strict=True)] for row in angles]
        ),
        stamps,
    )


def assert_bits(one: object, other: object) -> None:
    np.testing.assert_array_equal(np.asarray(one).view(np.uint64), np.asarray(other).view(np.uint64))

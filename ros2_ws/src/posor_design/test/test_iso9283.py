# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Paths of ISO 9283: sign and interpolation of the deviation where endpoint and reference cross a plane."""

from __future__ import annotations

import numpy as np
import pytest
from posor_design.iso9283_cycles import Motion, path_cycles, pose_cycles
from scipy.spatial.transform import Rotation

TURN, ASIDE = 1e-2, 1e-4  # turn along a path [rad], deviation across it [m]
STEPS = np.linspace(0.0, 1.0, 12)


def test_a_deviation_is_that_of_the_endpoint_from_the_reference_in_the_same_plane() -> None:
    there = np.concatenate([np.zeros(4), STEPS, np.ones(4), STEPS[::-1], np.zeros(4)])
    x = np.concatenate([there, there])  # two cycles
    stamps = np.arange(len(x)) * 1_000_000
    references = np.column_stack([x, 0.0 * x, 0.0 * x])
    positions = np.column_stack([x, 0.0 * x + ASIDE, 0.0 * x])
    turns = Rotation.from_rotvec(np.column_stack([0.0 * x, 0.0 * x, TURN * x]))
    motion = Motion(stamps, positions, references, (turns, Rotation.from_rotvec(np.zeros((len(x), 3)))))
    still = np.flatnonzero(np.concatenate([[True], np.diff(x) == 0.0]) & np.concatenate([np.diff(x) == 0.0, [True]]))
    groups = np.split(still, np.flatnonzero(np.diff(still) > 1) + 1)
    dwells = [(int(stamps[each[0]]), int(stamps[each[-1]])) for each in groups]
    _, numbers = pose_cycles(motion, dwells, 1e-3)
    forth, _ = path_cycles(motion, dwells, numbers)
    assert forth.attained.shape[1] == 2
    deviations = forth.attained - forth.commanded[:, None]
    np.testing.assert_allclose(deviations[..., 1], ASIDE, atol=1e-12)
    wanted = np.broadcast_to(TURN * forth.commanded[:, :1], deviations.shape[:2])
    np.testing.assert_allclose(deviations[..., 5], wanted, atol=1e-9)
    assert forth.figures()["AT_p"] == pytest.approx(ASIDE)

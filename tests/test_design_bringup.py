# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A POSOR as 'posor design posor' writes it runs at once: bringup with real nodes, poses within the requirement."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor_bringup.arms import load_checked_arm
from posor_design.layout_evaluation import evaluate, extreme_poses
from posor_design.layout_geometry import LayoutKind, Shares, arrange
from posor_design.layout_search import SearchResult
from posor_design.posor_output import output_files, write_design
from posor_design.requirement import load_requirement
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import EndpointState, JointTransform

pytestmark = pytest.mark.usefixtures("ros_domain")

REQUIREMENT = load_requirement(Path(__file__).with_name("requirement.yaml"))
SCANS = 100


@pytest.mark.parametrize(
    ("kind", "rotation"),
    [
        (LayoutKind("light_ring", 3, 4, gap_outside=True), 3.14),
        pytest.param(LayoutKind("bumpy_ring", 8, 4, gap_outside=False), 0.5, marks=pytest.mark.long),
    ],
    ids=("light_ring", "bumpy_ring"),
)
def test_a_designed_posor_runs(tmp_path: Path, kind: LayoutKind, rotation: float) -> None:
    """A bumpy ring counts from its home mark on, which it passes in every cycle of the scenario."""
    requirement = REQUIREMENT.changed(range={"rotation": rotation})
    layout = arrange(requirement, kind, 0.08, Shares(1.0, 0.0))
    assert layout is not None
    chosen = evaluate(requirement, kind, layout, extreme_poses(requirement, layout.gap))
    result = SearchResult(requirement, chosen, (chosen,), (chosen,), chosen, 1, "electronics")
    write_design(tmp_path / "design", output_files(result, chosen))
    arm = load_checked_arm(str(tmp_path / "design"))
    command = [*installed("posor_bringup", "bringup"), str(arm.path), "--layout", "composed"]
    with Graph() as graph:
        transforms = graph.collect(JointTransform, "/designed/joint1/transform")
        endpoints = graph.collect(EndpointState, "/designed/endpoint/state")
        with Program([*command, "--output", str(tmp_path / "out")]) as program:
            graph.wait_until(lambda: usable(transforms)[SCANS:] != [], "usable transforms")
            graph.wait_until(lambda: usable(endpoints)[SCANS:] != [], "usable endpoints")
            assert program.end(signal.SIGTERM) == 0
    counted = transforms[transforms.index(usable(transforms)[0]) :]
    assert len(usable(counted)) > 0.9 * len(counted)  # the chi-square test rejects one in a thousand
    covariances = [each.covariance_random + each.covariance_systematic for each in usable(counted)]
    sigmas = np.sqrt(np.diagonal(np.reshape(covariances, (-1, 6, 6)), axis1=1, axis2=2))
    assert np.all(sigmas <= requirement.sigmas)


def usable(messages: list[Any]) -> list[Any]:
    return [message for message in messages if message.state == JointTransform.STATE_OK]

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Start of a simulated arm: its stages are shown, and a missing topic ends it with one sentence."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.supervisor import ProcessError, Supervisor
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.arm_study.arm_receiver import ArmReceiver
from posor_lab.arm_study.arm_run import ArmLiveTable, ArmRun
from posor_lab.reports import graph_receiver
from posor_ros.node_program import ros_context
from rich.console import Console


def test_a_missing_topic_is_shown_and_ends_the_start(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver and posor_node of the joint run; chain_node is left out."""
    assert ros_domain
    monkeypatch.setattr(graph_receiver, "SILENCE_LIMIT_S", 8.0)
    monkeypatch.setattr(
        "posor_lab.arm_study.arm_run.arm_programs",
        lambda *given, **named: [each for each in arm_programs(*given, **named) if each.executable != "chain_node"],
    )
    simulation = ArmSimulation(load_checked_arm("test_rig"))
    screen = io.StringIO()
    with (
        ros_context(["test"]),
        Supervisor(tmp_path) as supervisor,
        ArmReceiver("test_rig", simulation.chain, stage=False) as receiver,
        ArmLiveTable("rig", Console(file=screen, width=200)) as table,
    ):
        run = ArmRun(simulation, supervisor, receiver, table)
        topic = "/test_rig/endpoint/pose_with_covariance (no diagnostics of /test_rig/chain_node yet)"
        with pytest.raises(ProcessError) as raised:
            run.start_nodes()
    assert str(raised.value).startswith(f"arm: no message for 8 s, missing: {topic}")
    lines = screen.getvalue().splitlines()
    assert lines[0] == "rig: starting 2 nodes"
    assert all(line.startswith(f"rig: starting 2 nodes, waiting for {topic}") for line in lines[1:])
    assert len(lines) > 1

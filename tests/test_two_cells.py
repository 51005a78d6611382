# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two arms of one arm file in one domain: each has its own topics and frames."""

from __future__ import annotations

import re
import shutil
import signal
from pathlib import Path

import pytest
from posor.errors import ParameterError
from posor_bringup.arm_programs import arm_programs, full_name, group_programs
from posor_bringup.arms import check_arm, load_checked_arm
from posor_bringup.commission_command import topics_of
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_lab.harness.rig_files import share
from posor_msgs.msg import EndpointState
from tf2_msgs.msg import TFMessage

CELLS = ("cell1", "hall/cell2")
ENCODER = "parameters: {encoder.sigma: 0.001, encoder.joint: joint1, encoder.topic: '{namespace}/encoders'}"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an arm file whose posor_node takes the encoder of the simulated arm."""
    path = tmp_path_factory.mktemp("arm") / "rig" / "arm.yaml"
    shutil.copytree(share() / "arms" / "test_rig", path.parent)
    new = f"  joint1:\n    calibration: calibrations/joint1.yaml\n    {ENCODER}"
    text, count = re.subn("^  joint1: .*$", new, path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert count == 1
    path.write_text(text, encoding="utf-8")
    scenario = path.with_name("scenario.yaml")
    text, count = re.subn("^rate: .*$", "rate: {value: 20, unit: Hz}", scenario.read_text("utf-8"), flags=re.MULTILINE)
    assert count == 1
    scenario.write_text(text, encoding="utf-8")
    return path


@pytest.mark.usefixtures("ros_domain")
def test_two_cells_share_a_domain(rig: Path, tmp_path: Path) -> None:
    def start(cell: str) -> Program:
        options = "--layout", "composed", "--output", str(tmp_path), "--namespace", cell, "--frame-prefix", f"{cell}/"
        return Program([*installed("posor_bringup", "bringup"), str(rig), *options])

    with Graph() as graph, start(CELLS[0]) as first, start(CELLS[1]) as second:
        states = [graph.collect(EndpointState, f"/{cell}/test_rig/endpoint/state") for cell in CELLS]
        frames = graph.collect(TFMessage, "/tf")

        def named() -> set[str]:
            return {each.child_frame_id for message in frames for each in message.transforms}

        wanted = {f"{cell}/joint1_target" for cell in CELLS}
        graph.wait_until(lambda: all(states) and wanted <= named(), "poses and frames of both cells")
        for cell, received in zip(CELLS, states, strict=True):
            assert (received[-1].header.frame_id, received[-1].child_frame_id) == (f"{cell}/base", f"{cell}/endpoint")
            encoders = f"/{cell}/test_rig/encoders"
            assert graph.node.count_publishers(f"/{cell}/test_rig/truth/endpoint") == 1
            assert (graph.node.count_publishers(encoders), graph.node.count_subscribers(encoders)) == (1, 1)
        assert all(name.startswith(tuple(f"{cell}/" for cell in CELLS)) for name in named())
        options = "--layout", "composed", "--output", str(tmp_path), "--namespace", "cell3", "--frame-prefix", "cell1/"
        with Program([*installed("posor_bringup", "bringup"), str(rig), *options]) as same_frame:
            same_frame.wait_for_line("frame cell1/endpoint: another bringup publishes it on /tf")
            assert same_frame.wait() == 1
        topics = {name for name, _ in graph.node.get_topic_names_and_types()}
        assert not [name for name in topics if name.startswith("/test_rig")]
        for program in (first, second):
            assert program.end(signal.SIGINT) == 0
    for cell in CELLS:
        view = (tmp_path / cell / "test_rig" / "arm.rviz").read_text(encoding="utf-8")
        assert f"Fixed Frame: {cell}/base" in view
        assert f'TF Prefix: "{cell}"' in view
        assert f"/{cell}/test_rig/endpoint/pose" in view


def test_every_name_of_an_arm_follows_its_namespace(rig: Path, tmp_path: Path) -> None:
    arm, plain = load_checked_arm(str(rig), "/cell1/"), load_checked_arm(str(rig))
    assert (arm.namespace, plain.namespace) == ("/cell1/test_rig", "/test_rig")
    programs = arm_programs(arm)
    assert list(map(full_name, programs)) == [f"/cell1{full_name(each)}" for each in arm_programs(plain)]
    assert [each.enclave for each in programs] == list(map(full_name, programs))
    assert [each.name for each in programs] == [each.name for each in arm_programs(plain)]
    for layout in ("composed", "drivers_apart"):
        assert {each.enclave for each in group_programs(programs, layout, tmp_path)} == {"/cell1/test_rig/compose"}
    topics = topics_of(arm, "laser")
    names = *topics.raw.values(), topics.steps, topics.reference, *(name for name, _ in topics.encoders.values())
    assert all(name.startswith("/cell1/test_rig/") for name in names)
    assert topics.encoders == {"joint1": ("/cell1/test_rig/encoders", "joint1")}


@pytest.mark.parametrize("namespace", ["1", "a b", "a//b", "//a", "cell-1", "é", "a\n", "_a", "a" * 41, "{arm}"])
def test_invalid_namespace_is_refused(namespace: str) -> None:
    error = refusal(ParameterError, check_arm, "test_rig", namespace=namespace)
    assert (error.where, error.exit_code) == ("arm test_rig", 2)

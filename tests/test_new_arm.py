# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""An arm as 'posor arm new' writes it: bringup with real nodes, OK poses, and a second bringup that is refused."""

from __future__ import annotations

import signal
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from posor_bringup.arm_files_command import main as arm
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_lab.harness.ros_domain import leased_domain
from posor_msgs.msg import EndpointState

pytestmark = pytest.mark.usefixtures("ros_domain")

OK_SCANS = 20


def test_a_beam_of_the_urdf_is_drawn_from_plate_to_plate(tmp_path: Path) -> None:
    assert arm(["new", "own", "--joints", "3", "--axes", "x,y,z", "--folder", str(tmp_path / "own")]) == 0
    root = ET.parse(tmp_path / "own" / "own.urdf").getroot()  # noqa: S314  written above
    for joint in (each for each in root.iter("joint") if str(each.get("name")).endswith("_beam")):
        link = next(each for each in root.iter("link") if each.get("name") == joint.find("parent").get("link"))  # type: ignore[union-attr]
        beam = link.findall("visual")[1]
        end, middle = (np.array(each.find("origin").get("xyz").split(), dtype=float) for each in (joint, beam))  # type: ignore[union-attr]
        np.testing.assert_allclose(2.0 * middle, end, atol=1e-12)
        assert np.linalg.norm(end) == pytest.approx(float(beam.find("geometry/cylinder").get("length")))  # type: ignore[union-attr,arg-type]


def test_a_new_arm_comes_up_and_a_second_one_of_its_name_is_refused(tmp_path: Path, ros_domain: int) -> None:
    assert arm(["new", "own", "--joints", "2", "--folder", str(tmp_path / "own")]) == 0
    command = [*installed("posor_bringup", "bringup"), str(tmp_path / "own"), "--layout", "composed", "--output"]
    with Graph() as graph, Program([*command, str(tmp_path / "first")]) as first:
        endpoints = graph.collect(EndpointState, "/own/endpoint/state")
        ok = EndpointState.STATE_OK
        graph.wait_until(lambda: sum(each.state == ok for each in endpoints) > OK_SCANS, "OK poses of the endpoint")
        folder = tmp_path / "first" / "own"
        with leased_domain() as other:
            for domain, output, where in ((ros_domain, "second", "arm /own"), (other, "first", folder)):
                with Program([*command, str(tmp_path / output)], {"ROS_DOMAIN_ID": str(domain)}) as second:
                    assert (second.wait(), second.stdout) == (1, [])
                    assert second.errors[0].startswith(f"{where}: another bringup ")
        assert not (tmp_path / "second").exists()
        assert not first.ended
        with Program([*command, str(tmp_path / "third"), "-p", "simulated.nois:=false"]) as third:
            assert third.wait() == 2
            (error,) = third.errors
            assert error == (
                "option -p simulated.nois: node driver_node, parameter 'simulated.nois': there is no such parameter; "
                "expected perhaps 'simulated.noise'."
            )
        assert first.end(signal.SIGKILL) == -signal.SIGKILL
        endpoints.clear()
        with Program([*command, str(tmp_path / "first")]) as again:
            again.wait_for_line("nodes started")
            graph.wait_until(lambda: sum(each.state == ok for each in endpoints) > OK_SCANS, "OK poses of the endpoint")
            assert again.end(signal.SIGINT) == 0

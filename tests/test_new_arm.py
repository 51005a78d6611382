"""An arm as 'posor arm new' writes it: bringup with real nodes, OK poses, and a second bringup that is refused."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from posor_bringup.arm_files_command import main as arm
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import EndpointState

pytestmark = pytest.mark.usefixtures("ros_domain")

OK_SCANS = 50


def test_a_new_arm_comes_up_and_a_second_one_of_its_name_is_refused(tmp_path: Path) -> None:
    assert arm(["new", "own", "--joints", "2", "--folder", str(tmp_path / "own")]) == 0
    command = [*installed("posor_bringup", "bringup"), str(tmp_path / "own"), "--layout", "composed", "--output"]
    with Graph() as graph, Program([*command, str(tmp_path / "first")]) as first:
        endpoints = graph.collect(EndpointState, "/own/endpoint/state")
        ok = EndpointState.STATE_OK
        graph.wait_until(lambda: sum(each.state == ok for each in endpoints) > OK_SCANS, "OK poses of the endpoint")
        with Program([*command, str(tmp_path / "second")]) as second:
            assert second.wait() == 1
            assert second.stdout == []
            assert "already runs in ROS domain" in second.errors[0]
            assert second.errors[0].startswith("node /own/")
        assert not (tmp_path / "second").exists()
        assert not first.ended
        with Program([*command, str(tmp_path / "third"), "-p", "simulated.nois:=false"]) as third:
            assert third.wait() == 2
            (error,) = third.errors
            assert error == (
                "option -p simulated.nois: node driver_node, parameter 'simulated.nois': there is no such parameter; "
                "expected perhaps 'simulated.noise'."
            )
        assert first.end(signal.SIGINT) == 0

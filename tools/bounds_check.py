# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Use every library of requirements/base.in once, without ROS; the last line printed is the arm's poses as JSON.

``make bounds`` runs this script in virtual environments with different versions. With ``--poses`` nothing is checked.
"""

from __future__ import annotations

import json
import runpy
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyvisa
import viser
from posor import ArmEstimates, load_arm, read_scans, to_arrow, to_dataframe
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import BagWriter
from posor.bags.recover_command import recover
from posor.bags.reprocess_command import main as reprocess
from posor.messages.message_definitions import Definition
from posor_design.budget_command import main as budget
from pymodbus.client import ModbusTcpClient

ROOT = Path(__file__).resolve().parent.parent
ARM = ROOT / "ros2_ws/src/posor_bringup/arms/five_axis/arm.yaml"
BAG = ROOT / "bags/five_axis"
PAGE_BYTES = 100_000


def check_bags(folder: Path, poses: np.ndarray) -> None:
    """Copy and recover a bag, estimate the arm from both copies, and write tables."""
    with opened_bag(BAG) as reader, BagWriter(folder / "copy") as writer:
        for each in reader.connections:
            definition = Definition(each.msgdef.data, each.digest)
            writer.add_topic(each.topic, each.msgtype, definition, each.ext.offered_qos_profiles)  # type: ignore[union-attr]  # a rosbag2
        for connection, time_ns, data in reader.messages():
            writer.write(connection.topic, time_ns, bytes(data))
    (rescue,) = recover(folder / "copy", folder / "recovered")
    assert not rescue.damages
    for name in ("copy", "recovered"):
        assert np.array_equal(load_arm(ARM).estimate(folder / name).endpoint.poses, poses)
    for form in ("parquet", "csv"):
        assert reprocess([str(BAG), "--arm", str(ARM), "--format", form, "--output", str(folder / form)]) == 0
    assert len(read_scans(ROOT / "bags/ymo"))


def check_pages(folder: Path) -> None:
    """Write a page with plots."""
    calibration = ARM.parent / "calibrations/elbow.yaml"
    assert budget([str(calibration), "--draws", "20000", "--output", str(folder / "budget")]) == 0
    assert max(page.stat().st_size for page in (folder / "budget").glob("*.html")) > PAGE_BYTES


def check_devices() -> None:
    """Make the clients and the server that drivers and ``view`` use."""
    pyvisa.ResourceManager("@py").close()
    assert not ModbusTcpClient("127.0.0.1", port=1, timeout=1, retries=0, reconnect_delay=0).connect()
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    server.scene.add_frame("/base")
    server.stop()


def check_all(estimates: ArmEstimates) -> None:
    """Run all checks."""
    runpy.run_path(str(ROOT / "examples/estimate_bag.py"))
    assert len(to_arrow(estimates.endpoint)) == len(to_dataframe(estimates.endpoint)) == len(estimates.endpoint)
    with tempfile.TemporaryDirectory() as folder:
        check_bags(Path(folder), estimates.endpoint.poses)
        check_pages(Path(folder))
    check_devices()


if __name__ == "__main__":
    found = load_arm(ARM).estimate(BAG)
    if "--poses" not in sys.argv:
        check_all(found)
    print(json.dumps(found.endpoint.poses.tolist()))

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
from matplotlib.figure import Figure
from posor import ArmEstimates, load_arm, read_scans, to_arrow, to_dataframe
from posor.bags.bag_reader import counted_messages, opened_bag
from posor.bags.recover_command import recover
from posor.bags.reprocess_command import main as reprocess
from posor.messages.message_definitions import schema_of_connection
from posor_design.budget_command import main as budget
from pymodbus.client import ModbusTcpClient

ROOT = Path(__file__).resolve().parent.parent
ARM = ROOT / "ros2_ws/src/posor_bringup/arms/five_axis/arm.yaml"
BAG = ROOT / "bags/five_axis"
PAGE_BYTES = 100_000
POSE = [f"pose.position.{axis}" for axis in "xyz"] + [f"pose.orientation.{axis}" for axis in "xyzw"]


def check_bags(folder: Path, poses: np.ndarray) -> None:
    """Write the poses to a bag, recover it, and read it again."""
    for form in ("bag", "parquet", "csv"):
        assert reprocess([str(BAG), "--arm", str(ARM), "--format", form, "--output", str(folder / form)]) == 0
    (rescue,) = recover(folder / "bag", folder / "recovered")
    assert not rescue.damages
    for bag in (folder / "bag", folder / "recovered"):
        with opened_bag(bag) as reader:
            (topic,) = [each for each in reader.connections if each.topic.endswith("/endpoint/pose")]
            schema = schema_of_connection(topic, str(bag))
            messages = [schema.values(data) for _, _, data in counted_messages(reader, [topic.topic], str(bag))]
        assert np.array_equal([[message[path] for path in POSE] for message in messages], poses)
    assert len(read_scans(ROOT / "bags/ymo"))


def check_pages(folder: Path) -> None:
    """Write a page with plots, and a figure."""
    figure = Figure()
    figure.subplots().plot([0.0, 1.0])
    figure.savefig(folder / "figure.png")
    calibration = ARM.parent / "calibrations/elbow.yaml"
    assert budget([str(calibration), "--draws", "1000", "--output", str(folder / "budget")]) == 0
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

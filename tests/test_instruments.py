"""Instruments from the wire to the endpoint: servers of simulated probes, driver_node, posor_node and chain_node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.testing.capancdt_server import CapaNcdtServer
from posor_drivers.testing.stream_server import LEAD, MAGIC, StreamServer
from posor_estimator.ros.message_conversion import stamp_ns
from posor_estimator.testing.graph import BEST_EFFORT, Graph
from posor_estimator.testing.program import Program, installed
from posor_msgs.msg import RawScan

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("ros_domain")

RATE = 200
FRAME_RATE = 1000
NS = 1_000_000_000
JOINT = "joint1"
RANGE_M = 5e-4
SCALE_V_PER_M, OFFSET_V = 4e4, -10.0


class Rig:
    """The simulated test rig: readings at any time, by interpolation, and the true endpoint at any stamp.

    A capaNCDT measures distances instead of the voltages of the gap probes; the instruments file turns them back.
    """

    def __init__(self) -> None:
        self.arm = load_checked_arm("test_rig")
        simulated = Imperfections(dropouts=False, latency=False, calibration_errors=False, beam_errors=False)
        self.simulation = ArmSimulation(self.arm, simulated, FRAME_RATE)
        self.ticks = np.arange(self.simulation.scenario.cycle_ticks)
        scans = self.simulation.scans(JOINT, self.ticks).scans
        readings = [scans.gap_voltages, scans.diode_currents.reshape(len(self.ticks), -1)]
        self.table = np.concatenate([*readings, scans.supply_voltages[:, None]], axis=1)
        self.probes = scans.gap_voltages.shape[1]
        self.lit_sources = scans.lit_sources[0].tolist()

    def distances(self, time_ns: int) -> list[float]:
        return [(voltage - OFFSET_V) / SCALE_V_PER_M for voltage in self.readings(time_ns)[: self.probes]]

    def others(self, time_ns: int) -> list[float]:
        return self.readings(time_ns)[self.probes :]

    def readings(self, time_ns: int) -> list[float]:
        position = time_ns * FRAME_RATE / NS
        number = int(position)
        share = position - number
        rows = (self.table[number % len(self.table)], self.table[(number + 1) % len(self.table)])
        return list((1.0 - share) * rows[0] + share * rows[1])

    def endpoints(self, stamps_ns: list[int]) -> np.ndarray[Any, Any]:
        ticks = np.rint(np.array(stamps_ns) * (FRAME_RATE / NS)).astype(np.int64)
        return np.asarray(self.simulation.truth(ticks).endpoint.translations)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig()


def write_files(folder: Path, rig: Rig, probes: CapaNcdtServer, others: StreamServer) -> Path:
    """Write instruments file and arm file; return the arm file."""
    gaps, currents = [f"gap{n}" for n in range(rig.probes)], [f"current{n}" for n in range(8)]
    channels = [*currents, "supply"]
    units = {name: {"unit": "A" if name in currents else "V"} for name in channels}
    box = {
        "kind": "stream",
        "transport": "tcp",
        "host": "127.0.0.1",
        "port": others.port,
        "rate": {"value": FRAME_RATE, "unit": "Hz"},
        "format": f"{LEAD}{len(channels)}d",
        "fields": ["magic", "counter", *channels],
        "constants": {"magic": MAGIC},
        "channels": units,
    }
    controller = {
        "kind": "capancdt_6200",
        "host": "127.0.0.1",
        "command_port": probes.command_port,
        "data_port": probes.data_port,
        "rate": {"value": 1e6 / 960, "unit": "Hz"},
        "channels": {
            name: {"number": n, "range": {"value": RANGE_M, "unit": "m"}} for n, name in enumerate(gaps, start=1)
        },
    }
    scale = {"scale": {"value": SCALE_V_PER_M, "unit": "V/m"}, "offset": {"value": OFFSET_V, "unit": "V"}}
    arm = rig.arm
    joint = {
        "frame_id": arm.calibration(JOINT).frames.parent,
        "gap_voltages": [{"channel": f"probes/{name}", **scale} for name in gaps],
        "diode_currents": [{"channel": f"box/{name}"} for name in currents],
        "lit_sources": rig.lit_sources,
        "supply_voltage": {"channel": "box/supply"},
    }
    instruments = {
        "format": "posor_instruments",
        "version": 1,
        "name": "rig",
        "rate": {"value": RATE, "unit": "Hz"},
        "latency": {"value": 0.05, "unit": "s"},
        "devices": {"probes": controller, "box": box},
        "joints": {JOINT: joint},
    }
    (folder / "instruments.yaml").write_text(yaml.safe_dump(instruments), encoding="utf-8")
    content = yaml.safe_load(arm.path.read_text(encoding="utf-8"))
    del content["scenario"]
    for key in ("urdf", "beams"):
        content[key] = str(arm.path.parent / content[key])
    content["joints"] = {JOINT: {"calibration": str(arm.calibrations[JOINT])}}
    parameters = {"instruments.file": "{folder}/instruments.yaml", "instruments.joint": "{joint}"}
    content["driver"] = {"source": "instruments", "parameters": parameters}
    (folder / "arm.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return folder / "arm.yaml"


def test_readings_of_two_devices_give_the_true_endpoint(tmp_path: Path, rig: Rig) -> None:
    ranges = dict.fromkeys(range(1, rig.probes + 1), RANGE_M)
    with (
        CapaNcdtServer(rig.distances, ranges, drift=-20e-6) as probes,
        StreamServer(rig.others, FRAME_RATE, drift=50e-6) as server,
    ):
        arm = write_files(tmp_path, rig, probes, server)
        arguments = [str(arm), "--layout", "composed", "--output", str(tmp_path / "out")]
        with Program([*installed("posor_bringup", "bringup"), *arguments]) as program, Graph() as graph:
            poses = graph.collect(PoseWithCovarianceStamped, "/test_rig/endpoint/pose_with_covariance", BEST_EFFORT)
            raw = graph.collect(RawScan, f"/test_rig/{JOINT}/raw", BEST_EFFORT)
            graph.watch_diagnostics()
            graph.wait_until(lambda: len(poses) >= 400, "400 poses")
            device = f"/test_rig/{JOINT}/driver_node: device box"
            graph.wait_for_status(device, "tcp 127.0.0.1")
            graph.wait_for_status(f"/test_rig/{JOINT}/driver_node: device probes", "DT62")
            server.stalled.set()
            graph.wait_for_status(device, "box: no frame for 0.3")
            taken = len(raw)
            server.stalled.clear()
            graph.wait_until(lambda: len(raw) > taken + 50, "scans after the stall")
            graph.wait_for_status(device, "tcp 127.0.0.1")
            assert program.end() == 0
    assert {stamp_ns(scan) * RATE % NS for scan in raw} == {0}
    stamps = [stamp_ns(pose) for pose in poses]
    points = [pose.pose.pose.position for pose in poses]
    errors = np.array([(point.x, point.y, point.z) for point in points]) - rig.endpoints(stamps)
    sigmas = np.sqrt([np.array(pose.pose.covariance).reshape(6, 6).diagonal()[:3] for pose in poses])
    inside = np.mean(np.abs(errors) < 2.0 * sigmas)
    rms = 1e6 * np.sqrt(np.mean(errors**2, axis=0))
    stated = 1e6 * sigmas.mean(axis=0)
    print(f"simulated: rms error {rms.round(2)} um, stated {stated.round(2)} um, {inside:.3f} within 2 sigma")
    assert inside > 0.95

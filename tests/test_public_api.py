"""The public Python API in a plain virtual environment without ROS: the numbers that the nodes publish."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import posor
import pytest
from geometry_msgs.msg import PoseStamped
from posor.model.fault import State
from posor.numerics import compiled
from posor_bringup.arms import find_arm
from rclpy.serialization import deserialize_message

from tests.rig_replay import read_bag_messages

if TYPE_CHECKING:
    from posor.chain.arm_file import ParameterValue

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ros2_ws" / "src" / "posor"
EXAMPLE = ROOT / "examples" / "estimate_bag.py"
BAG = ROOT / "bags" / "five_axis"
MAX_EXAMPLE_LINES = 15
TOLERANCE = 1e-12
"""Largest difference of positions [m] and quaternions."""

RUN_EXAMPLE = f"""
import json, runpy, sys
endpoint = runpy.run_path({str(EXAMPLE)!r})["endpoint"]
ros = sorted(name for name in sys.modules if name.split(".")[0] in ("rclpy", "posor_msgs", "ament_index_python"))
result = {{"ros": ros, "stamps": endpoint.stamps_ns.tolist(), "poses": endpoint.poses.tolist()}}
print(json.dumps(result), file=sys.stderr)
"""
IMPORT = """
import sys, time
begin = time.perf_counter()
import posor
print(time.perf_counter() - begin, "numpy" in sys.modules)
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of a virtual environment with nothing but posor and what it requires.

    The pip of the workspace installs. Libraries that no test imports are not compiled to bytecode.
    """
    folder = tmp_path_factory.mktemp("plain")
    ignored = shutil.ignore_patterns("*.egg-info", "build", "__pycache__", "test")
    source = shutil.copytree(PACKAGE, folder / "posor", ignore=ignored)  # pip builds in the folder
    subprocess.run([sys.executable, "-I", "-m", "venv", "--without-pip", str(folder / "venv")], check=True)
    python = folder / "venv" / "bin" / "python"
    pip = [sys.executable, "-I", "-m", "pip", "--python", str(python), "--quiet", "--disable-pip-version-check"]
    install = ["install", "--no-compile", "--constraint", str(ROOT / "requirements" / "base.txt"), str(source)]
    subprocess.run([*pip, *install], check=True, env=plain_environment())
    return python


def plain_environment() -> dict[str, str]:
    """Return the environment without ROS and without the workspace, except the machine code of the same kernels."""
    foreign = ("PYTHON", "AMENT_", "ROS_", "COLCON_", "CMAKE_", "LD_LIBRARY_PATH", "VIRTUAL_ENV")
    plain = {name: value for name, value in os.environ.items() if not name.startswith(foreign)}
    return plain | {"NUMBA_CACHE_DIR": str(Path(compiled.cache_folder()).parent)}


def run(python: Path, code: str) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, env=plain_environment())


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_example_gives_the_published_poses_without_ros(python: Path) -> None:
    done = run(python, RUN_EXAMPLE)
    result: dict[str, Any] = json.loads(done.stderr.splitlines()[-1])
    assert result["ros"] == []
    published = [deserialize_message(data, PoseStamped) for data in read_bag_messages(BAG)["/five_axis/endpoint/pose"]]
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in published]
    positions = [[message.pose.position.x, message.pose.position.y, message.pose.position.z] for message in published]
    assert result["stamps"] == stamps
    poses = np.array(result["poses"])
    np.testing.assert_allclose(poses[:, :3], positions, rtol=0.0, atol=TOLERANCE)
    rotations = [[getattr(message.pose.orientation, axis) for axis in "xyzw"] for message in published]
    np.testing.assert_allclose(poses[:, 3:], rotations, rtol=0.0, atol=TOLERANCE)
    lines = done.stdout.splitlines()
    assert len(lines) == len(stamps)
    assert lines[0].startswith(f"{stamps[0]} ns: {positions[0][0]:.9f} m ± ")


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_import_takes_milliseconds(python: Path) -> None:
    seconds, numpy_is_imported = min(run(python, IMPORT).stdout.split() for _ in range(3))
    assert numpy_is_imported == "False"
    assert float(seconds) < 0.1


def test_the_example_is_short_and_uses_public_names_only() -> None:
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_EXAMPLE_LINES
    imports = [line for line in lines if "import" in line and not line.startswith('"""')]
    assert imports == ["from posor import load_arm"]


def test_every_public_name_exists_and_others_do_not() -> None:
    assert dir(posor) == sorted(posor.__all__)
    for name in posor.__all__:
        assert getattr(posor, name).__name__ == name
    with pytest.raises(AttributeError, match=r"^module 'posor' has no attribute 'estimate_bag'$"):
        _ = posor.estimate_bag


def test_an_arm_gives_joints_and_endpoint_with_covariances_as_arrays() -> None:
    arm = posor.load_arm(find_arm("five_axis"))
    estimates = arm.estimate(BAG)
    assert list(estimates.joints) == list(arm.calibrations)
    elbow, endpoint = estimates.joints["elbow"], estimates.endpoint
    assert elbow.covariances.shape == (len(elbow), 6, 6)
    assert np.count_nonzero(elbow.states == State.LOST) == 4
    assert endpoint.angles.shape == (len(endpoint), len(estimates.chain))
    variances = np.diagonal(endpoint.covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(endpoint.standard_uncertainties**2, variances, rtol=1e-14)
    random, systematic = (arm.estimate(BAG, covariance=kind).joints["elbow"] for kind in ("random", "systematic"))
    np.testing.assert_array_equal(random.covariances + systematic.covariances, elbow.covariances)
    tables = posor.to_arrow(estimates)
    assert tables["endpoint"].column_names[-5:] == [f"angle_{joint}" for joint in estimates.chain]
    np.testing.assert_array_equal(tables["elbow"]["cov_x_x"].to_numpy(), elbow.covariances[:, 0, 0])


def test_an_arm_is_estimated_with_the_parameters_of_its_file() -> None:
    arm = posor.load_arm(find_arm("five_axis"))
    elbow: dict[str, ParameterValue] = {"covariance": "random", "false_alarm": 0.1}
    stated = replace(arm, posor_parameters={**arm.posor_parameters, "elbow": elbow})
    estimates, usual = stated.estimate(BAG), arm.estimate(BAG)
    assert np.count_nonzero(estimates.joints["elbow"].states == State.LOST) > 4
    ends = [np.trace(each.joints["elbow"].covariances[-1]) for each in (estimates, usual)]
    assert ends[0] < ends[1]
    np.testing.assert_array_equal(estimates.joints["shoulder"].covariances, usual.joints["shoulder"].covariances)
    with pytest.raises(posor.PosorError, match=r"covariance: 'none' is unknown; expected random, "):
        arm.estimate(BAG, covariance="none")  # type: ignore[arg-type]


def test_scans_of_a_bag_are_estimated_one_by_one_or_all_at_once() -> None:
    scans = posor.read_scans(BAG, "/five_axis/elbow/raw")
    arm = posor.load_arm(find_arm("five_axis"))
    joint = arm.estimate(BAG).joints["elbow"]
    assert scans.stamps_ns.tolist() == joint.stamps_ns.tolist()
    assert posor.to_arrow(scans)["gap_voltage_0"].to_pylist() == scans.gap_voltages[:, 0].tolist()


@pytest.mark.parametrize(
    ("function", "library"), [("to_dataframe", "pandas"), ("to_arrow", "pyarrow")], ids=["pandas", "pyarrow"]
)
def test_a_missing_library_is_named(function: str, library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(posor.ParameterError) as caught:
        getattr(posor, function)(posor.read_scans(BAG, "/five_axis/elbow/raw"))
    assert str(caught.value) == f"{function}: the Python library '{library}' is not installed; expected {library}."


def test_data_that_cannot_be_a_table_are_refused() -> None:
    with pytest.raises(posor.ParameterError, match=r"^data of type list cannot be a table; expected ArmEst"):
        posor.to_arrow([])  # type: ignore[arg-type]

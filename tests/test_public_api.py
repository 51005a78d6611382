# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The public Python API in a plain virtual environment without ROS: the numbers that the nodes publish."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import posor
import posor_calibration
import pytest
from posor.bags.recording import Recording
from posor.calibration.designs import design
from posor.chain.arm_file import ParameterValue
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("posor", "posor_calibration")
EXAMPLE = ROOT / "examples" / "estimate_bag.py"
BAG = ROOT / "bags" / "five_axis"
MAX_EXAMPLE_LINES = 15
TOLERANCE = 1e-12  # largest difference of positions [m] and quaternions

RUN_EXAMPLE = f"""
import json, runpy, sys
from posor.numerics.compiled import MODE
endpoint = runpy.run_path({str(EXAMPLE)!r})["endpoint"]
ros = sorted(name for name in sys.modules if name.split(".")[0] in ("rclpy", "posor_msgs", "ament_index_python"))
result = {{"mode": MODE, "ros": ros, "stamps": endpoint.stamps_ns.tolist(), "poses": endpoint.poses.tolist()}}
print(json.dumps(result), file=sys.stderr)
"""
FIT = """
import sys
import numpy as np
from posor import load_calibration, simulate
from posor_calibration import fit
calibration = "ros2_ws/src/posor_bringup/arms/five_axis/calibrations/elbow.yaml"
turn = 2e-4 * np.column_stack([np.sin(np.arange(40.0)), np.cos(np.arange(40.0)), np.zeros(40)])
cosines = np.sqrt(1.0 - np.sum(turn**2, axis=1) / 4.0)
poses = np.column_stack([np.tile([0.0, 0.0, 0.76e-3], (40, 1)), turn / 2.0, cosines])
scans = simulate(load_calibration(calibration), poses, rate=10.0, seed=1)
scans = scans.with_fields({"at_home": np.where(np.arange(40) == 0, 2, 0)})  # stated by the operator
result = fit("zero_drift", calibration, scans, references={"cmm": poses}, uncertainties={"cmm": (1e-6, 1e-6)})
assert result.report.startswith("zero_drift: usable.")
assert not [name for name in sys.modules if name.split(".")[0] in ("rclpy", "posor_msgs")]
"""
IMPORT = """
import sys, time
begin = time.perf_counter()
import posor
print(time.perf_counter() - begin, "numpy" in sys.modules)
"""


@pytest.fixture(scope="module")
def wheels() -> list[Path]:
    """Return the wheels of ``make wheels``."""
    subprocess.run(["make", "--no-print-directory", "wheels"], cwd=ROOT, check=True)  # noqa: S607
    return [next((ROOT / "build" / "wheels").glob(f"{name}-*.whl")) for name in PACKAGES]


@pytest.fixture(scope="module", params=["3.11", "3.12"])
def python(request: pytest.FixtureRequest, wheels: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of a virtual environment with nothing but the wheels of two libraries and what they require.

    The pip of the workspace installs. Libraries that no test imports are not compiled to bytecode.
    """
    venv = tmp_path_factory.mktemp("plain") / "venv"
    subprocess.run([find_python(request.param), "-I", "-m", "venv", "--without-pip", str(venv)], check=True)
    python = venv / "bin" / "python"
    pip = [sys.executable, "-I", "-m", "pip", "--python", str(python), "--quiet", "--disable-pip-version-check"]
    constraints = [f"--constraint={ROOT / 'requirements' / name}.txt" for name in ("base", "ros-jazzy")]
    subprocess.run(
        [*pip, "install", "--no-compile", *constraints, *map(str, wheels)], check=True, env=plain_environment()
    )
    return python


def find_python(version: str) -> str:
    """Return an interpreter of a version, or skip the test."""
    for candidate in (sys.executable, f"python{version}"):
        shown = [candidate, "-c", "import sys; print('{}.{}'.format(*sys.version_info))"]
        if (
            shutil.which(candidate)
            and subprocess.run(shown, capture_output=True, text=True, check=False).stdout.strip() == version
        ):
            return candidate
    pytest.skip(f"this machine has no python{version}")


def plain_environment() -> dict[str, str]:
    """Return the environment without ROS and without the workspace."""
    foreign = ("PYTHON", "AMENT_", "ROS_", "COLCON_", "CMAKE_", "LD_LIBRARY_PATH", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if not name.startswith(foreign)}


def run(python: Path, code: str) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, env=plain_environment())


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_example_gives_the_poses_of_the_workspace_without_ros(python: Path) -> None:
    done = run(python, RUN_EXAMPLE)
    result: dict[str, Any] = json.loads(done.stderr.splitlines()[-1])
    assert (result["mode"], result["ros"]) == ("library", [])
    endpoint = posor.load_arm("five_axis").estimate(BAG).endpoint
    stamps = endpoint.stamps_ns.tolist()
    assert result["stamps"] == stamps
    np.testing.assert_allclose(result["poses"], endpoint.poses, rtol=0.0, atol=TOLERANCE)
    lines = done.stdout.splitlines()
    assert len(lines) == len(stamps)
    assert lines[0].startswith(f"{stamps[0]} ns: {endpoint.poses[0, 0]:.9f} m ± ")


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_calibration_is_fitted_without_ros(python: Path) -> None:
    run(python, FIT)


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


@pytest.mark.parametrize("library", [posor, posor_calibration], ids=PACKAGES)
def test_every_public_name_exists_and_others_do_not(library: ModuleType) -> None:
    assert dir(library) == sorted(library.__all__)
    for name in library.__all__:
        assert getattr(library, name).__name__ == name
    with pytest.raises(AttributeError, match=rf"^module '{library.__name__}' has no attribute 'estimate_bag'$"):
        _ = library.estimate_bag


def test_an_arm_gives_joints_and_endpoint_with_covariances_as_arrays() -> None:
    arm = posor.load_arm("five_axis")
    estimates = arm.estimate(BAG, false_alarm=0.1)
    assert list(estimates.joints) == list(arm.calibrations)
    elbow, endpoint = estimates.joints["elbow"], estimates.endpoint
    assert elbow.covariances().shape == (len(elbow), 6, 6)
    assert np.count_nonzero(elbow.states == State.LOST) == 4
    assert endpoint.angles.shape == (len(endpoint), len(estimates.chain))
    for each in (elbow, endpoint):
        np.testing.assert_array_equal(each.covariances(), each.covariances_random + each.covariances_systematic)
        assert np.nanmin(np.trace(each.covariances_systematic, axis1=1, axis2=2)) > 0.0
        variances = np.diagonal(each.covariances(), axis1=1, axis2=2)
        np.testing.assert_allclose(each.standard_uncertainties**2, variances, rtol=1e-14)
    assert 0.0 < endpoint.stamp_shifts[-1].max() < 1e-9  # simulated stamps are off by half a nanosecond at most
    assert sum(elbow.lost_reasons().values()) == 4
    tables = posor.to_arrow(estimates)
    assert tables["endpoint"].column_names[-5:] == [f"angle_{joint}" for joint in estimates.chain]
    for name, each in (("elbow", elbow), ("endpoint", endpoint)):
        for part, covariances in (("random", each.covariances_random), ("systematic", each.covariances_systematic)):
            np.testing.assert_array_equal(tables[name][f"cov_{part}_x_rz"].to_numpy(), covariances[:, 0, 5])


def test_an_arm_is_estimated_with_the_parameters_of_its_file() -> None:
    arm = posor.load_arm("five_axis")
    elbow: dict[str, ParameterValue] = {"false_alarm": 0.99}
    stated = replace(arm, posor_parameters={**arm.posor_parameters, "elbow": elbow})
    estimates, usual = stated.estimate(BAG), arm.estimate(BAG)
    assert np.count_nonzero(estimates.joints["elbow"].states == State.LOST) > 4
    np.testing.assert_array_equal(estimates.joints["shoulder"].poses, usual.joints["shoulder"].poses)
    former = replace(arm, posor_parameters={**arm.posor_parameters, "elbow": {"covariance": "total"}})
    with pytest.raises(posor.PosorError, match=r"'covariance': there is no such parameter; expected none: 'covar"):
        former.estimate(BAG)


def test_scans_of_a_bag_are_estimated_one_by_one_or_all_at_once() -> None:
    scans = posor.read_scans(BAG, "/five_axis/elbow/raw")
    arm = posor.load_arm("five_axis")
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
    expected = f"{function}: the Python library '{library}' is not installed; expected pip install 'posor[tables]'."
    assert str(caught.value) == expected


POSES = [pin.SE3(rotation_from_native(1e-4, -2e-4, 1e-4 * n), np.array([2e-5, 1e-5, 0.7e-3])) for n in range(20)]
CALIBRATION = design("triad_diodes")


def test_simulated_scans_give_back_their_poses() -> None:
    rows = np.array([pin.SE3ToXYZQUAT(pose) for pose in POSES])
    scans = posor.simulate(CALIBRATION, rows, rate=2000.0)
    assert scans.stamps_ns[:2].tolist() == [500_000, 1_000_000]
    found = posor.Posor(CALIBRATION).estimate_all(scans)
    np.testing.assert_allclose(found.poses, rows, rtol=0.0, atol=1e-11)
    assert found.numbers.tolist() == scans.numbers.tolist() == list(range(20))
    same = posor.simulate(CALIBRATION, POSES, stamps_ns=scans.stamps_ns)
    np.testing.assert_allclose(same.gap_voltages, scans.gap_voltages, rtol=0.0, atol=1e-9)
    noisy, again = (posor.simulate(CALIBRATION, POSES, seed=7, temperatures=293.15) for _ in range(2))
    assert noisy.gap_voltages.tobytes() == again.gap_voltages.tobytes()
    assert np.all(noisy.gap_voltages != scans.gap_voltages)
    far = posor.simulate(CALIBRATION, rows + [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])  # noqa: RUF005  an array
    assert np.isnan(far.gap_voltages).all()


def test_lost_scans_are_explained() -> None:
    scans = posor.simulate(CALIBRATION, POSES).editable()
    scans.gap_voltages[5:9, 1] = np.nan
    scans.diode_currents[12, 0] = 0.0
    found, single = posor.Posor(CALIBRATION).estimate_all(scans), posor.Posor(CALIBRATION)
    reasons = [single.estimate(scans[n]).reason for n in range(20)]
    assert [found.reason(n) for n in range(20)] == reasons
    assert found.lost_reasons() == {reasons[5]: 4, reasons[12]: 1}
    assert sum(posor.Posor(CALIBRATION).estimate_all(scans.select(slice(0, 5))).lost_reasons().values()) == 0


def results() -> list[Any]:
    scans, estimator = posor.simulate(CALIBRATION, POSES), posor.Posor(CALIBRATION)
    return [
        scans,
        estimator.estimate_all(scans),
        posor.error_budget(estimator, scans[0], POSES[0]),
        posor.joint_reliability(estimator, scans[0], POSES[0]),
        posor.load_arm("five_axis").estimate(BAG).endpoint,
    ]


def test_results_are_read_only_tables_with_a_short_text() -> None:
    for result in results():
        names = [name for name in dir(result) if not name.startswith("_")]
        arrays = {name: array for name in names if isinstance(array := getattr(result, name), np.ndarray)}
        derived = {"residuals", "standard_uncertainties", "sigmas"}
        assert [name for name, array in arrays.items() if array.flags.writeable and name not in derived] == []
        assert len(repr(result)) < 300
        assert "\n" not in repr(result)
        assert len(posor.to_arrow(result)) > 0
    arm, estimator = posor.load_arm("five_axis"), posor.Posor(CALIBRATION)
    scan = posor.simulate(CALIBRATION, POSES)[0]
    for each in (arm, arm.calibration("elbow"), estimator, scan, estimator.estimate(scan)):
        assert len(repr(each)) < 200
    assert len(repr(arm.estimate(BAG)).splitlines()) == 1 + len(arm.calibrations) + 1


SCANS = {"stamps_ns": np.arange(3)}
WRONG: list[tuple[Callable[[], Any], type[posor.PosorError], str]] = [
    (lambda: posor.Scans.from_fields(**SCANS, gap_volts=np.zeros((3, 3))), posor.ParameterError, "gap_voltages"),
    (lambda: posor.Scans.from_fields(gap_voltages=np.zeros((3, 3))), posor.ParameterError, "middle of each exposure"),
    (lambda: posor.Scans.from_fields(stamps_ns=["a"]), posor.ParameterError, "whole numbers"),  # type: ignore[arg-type]
    (lambda: posor.Scans.from_fields(**SCANS, numbers=np.arange(2)), posor.ShapeError, "(3,)"),
    (lambda: posor.Scans.from_fields(stamps_ns=5), posor.ShapeError, "(1,)"),  # type: ignore[arg-type]
    (lambda: posor.Scans.of([1]), posor.ParameterError, "sequence of Scan"),  # type: ignore[list-item]
    (lambda: posor.Posor("/x"), posor.ParameterError, "Calibration"),  # type: ignore[arg-type]
    (lambda: posor.Posor(CALIBRATION, false_alarm=float("nan")), posor.ParameterError, "probability"),
    (lambda: posor.Posor(CALIBRATION, false_alarm=-0.1), posor.ParameterError, "probability"),
    (lambda: posor.Posor(CALIBRATION).estimate_all([]), posor.ParameterError, "Scans"),  # type: ignore[arg-type]
    (lambda: posor.Posor(CALIBRATION).estimate(5), posor.ParameterError, "Scan"),  # type: ignore[arg-type]
    (lambda: posor.load_arm(5), posor.ParameterError, "path of an arm file"),  # type: ignore[arg-type]
    (lambda: posor.load_calibration(5), posor.ParameterError, "calibration file"),  # type: ignore[arg-type]
    (lambda: posor.read_scans(None), posor.ParameterError, "path of a bag"),  # type: ignore[arg-type]
    (lambda: posor.load_arm("five_axis").estimate(BAG, false_alarm=2.0), posor.ParameterError, "0 and 1"),
    (lambda: posor.simulate(CALIBRATION, np.zeros((2, 6))), posor.ShapeError, "(n, 7)"),
    (lambda: posor.simulate(CALIBRATION, np.zeros((2, 7))), posor.ParameterError, "unit quaternion"),
    (lambda: posor.simulate(CALIBRATION, POSES, rate=-1.0), posor.ParameterError, "above zero"),
    (lambda: posor.simulate(CALIBRATION, POSES, stamps_ns=np.zeros(20)), posor.ParameterError, "whole numbers"),
    (lambda: posor.simulate(CALIBRATION, POSES, temperatures="warm"), posor.ParameterError, "numbers"),
    (lambda: posor.to_arrow([]), posor.ParameterError, "Reliability"),  # type: ignore[arg-type]
    (lambda: posor_calibration.fit("zero_drif", CALIBRATION, BAG), posor.ParameterError, "zero_drift"),
    (lambda: posor_calibration.fit("bundle", CALIBRATION, BAG, looss=1), posor.ParameterError, "loss"),
    (lambda: posor_calibration.fit("bundle", CALIBRATION, [1]), posor.ParameterError, "Scans"),  # type: ignore[arg-type]
]


@pytest.mark.parametrize(("call", "error", "expected"), WRONG)
def test_a_wrong_argument_is_named_with_the_valid_ones(
    call: Callable[[], Any], error: type[posor.PosorError], expected: str
) -> None:
    with pytest.raises(error) as caught:
        call()
    assert expected in caught.value.expected
    assert caught.value.where or caught.value.what == "data of type list cannot be a table"


MASKED: Any = np.ma.masked_array(np.ones((3, 3)), mask=np.diag([True, False, False]))
ANY: Any = posor  # without types, for arguments of a wrong type
REFUSED: list[tuple[str, Callable[[], Any], str, str]] = [
    (
        "float stamps",
        lambda: ANY.Scans.from_fields(stamps_ns=[np.nan, 1.0]),
        "stamps_ns holds float64",
        "whole numbers",
    ),
    ("ragged stamps", lambda: ANY.Scans.from_fields(stamps_ns=[[1], [1, 2]]), "stamps_ns is of type list", "numbers"),
    ("float mark", lambda: field("at_home", np.full(3, 0.5)), "at_home holds float64", "whole numbers"),
    ("complex", lambda: field("gap_voltages", np.full((3, 3), 1j)), "gap_voltages holds complex128", "real numbers"),
    ("ragged", lambda: field("gap_voltages", [[1.0], [1.0, 2.0]]), "gap_voltages is of type list", "numbers"),
    ("no fields", lambda: scans_of_three().with_fields(None), "NoneType", "Mapping"),
    ("numbered field", lambda: field(1, 2), "'1' is unknown", "one of numbers"),
    ("scans of None", lambda: ANY.Scans.of(None), "no sequence", "sequence of Scan"),
    ("slice", lambda: scans_of_three()[0:2], "slice(0, 2, None)", ".part(begin, end)"),
    ("text as index", lambda: scans_of_three()["x"], "'x'", "an integer"),
    ("empty data", lambda: fit(ANY.Scans.of([])), "no scans", "at least one"),
    ("empty recording", lambda: fit(Recording(posor.Scans.of([]), {}, "")), "no scans", "at least one"),
    ("references", lambda: fit(references=[1]), "list", "Mapping"),
    ("reference", lambda: fit(references={"/cmm": "abc"}), "str", "real numbers"),
    ("uncertainties", lambda: fit(uncertainties=[1.0]), "list", "Mapping"),
    ("uncertainty", lambda: fit(uncertainties={"/cmm": None}), "NoneType", "real numbers"),
    ("instruments", lambda: fit(instruments=["x"]), "list", "Mapping"),
    ("instrument", lambda: fit(instruments={"/cmm": 5}), "int", "str"),
    ("procedure", lambda: posor_calibration.fit([], CALIBRATION, BAG), "procedure []", "one of"),  # type: ignore[arg-type]
    ("joint", lambda: posor.load_arm("five_axis").calibration("elbo"), "'elbo'", "elbow"),
    ("budget", lambda: ANY.error_budget(CALIBRATION, None, POSES[0]), "Calibration", "Posor"),
    ("pose", lambda: ANY.joint_reliability(posor.Posor(CALIBRATION), None, np.eye(4)), "ndarray", "SE3"),
    ("scalar stamp", lambda: ANY.simulate(CALIBRATION, POSES, stamps_ns=5), "shape ()", "(20,)"),
    (
        "stamps of poses",
        lambda: ANY.simulate(CALIBRATION, POSES, stamps_ns=[[1], [1, 2]]),
        "stamps_ns",
        "whole numbers",
    ),
    ("rates", lambda: ANY.simulate(CALIBRATION, POSES, rate=[1.0, 2.0]), "rate [1.0, 2.0]", "one number"),
    ("masked readings", lambda: field("gap_voltages", MASKED), "gap_voltages has 1 masked entries", "NaN"),
    ("masked rows", lambda: field("gap_voltages", list(MASKED)), "gap_voltages has 1 masked entries", "NaN"),
    ("masked scan", lambda: ANY.Scans.of([masked_scan()]), "gap_voltages has 1 masked entries", "NaN"),
    (
        "estimate of a masked scan",
        lambda: posor.Posor(CALIBRATION).estimate(masked_scan()),
        "gap_voltages has 1 masked entries",
        "NaN",
    ),
    ("masked reference", lambda: fit(references={"/cmm": MASKED}), "/cmm has 1 masked entries", "NaN"),
    ("masked uncertainty", lambda: fit(uncertainties={"/cmm": MASKED[0]}), "/cmm has 1 masked entries", "NaN"),
    ("masked poses", lambda: posor.simulate(CALIBRATION, masked_poses()), "poses has 7 masked entries", "NaN"),
    ("seed", lambda: posor.simulate(CALIBRATION, POSES, seed=-1), "seed -1", "zero or more"),
    ("theta", lambda: ANY.Posor(CALIBRATION).confirm_theta("x", 1e-6), "theta 'x'", "finite numbers"),
    ("theta None", lambda: ANY.Posor(CALIBRATION).confirm_theta(None, 1e-6), "theta None", "finite numbers"),
    ("null character", lambda: posor.load_calibration("a\0b"), "null character", "calibration file"),
    (
        "null character in fit",
        lambda: posor_calibration.fit("bundle", "a\0b", BAG),
        "null character",
        "calibration file",
    ),
]


def masked_scan() -> posor.Scan:
    return posor.Scan(stamp_ns=1, gap_voltages=MASKED[0])


def masked_poses() -> Any:
    poses = np.tile([0.0, 0.0, 735e-6, 0.0, 0.0, 0.0, 1.0], (2, 1))
    return np.ma.masked_array(poses, mask=np.repeat([[True], [False]], 7, axis=1))


def test_a_masked_array_without_masked_entries_is_an_array() -> None:
    whole = np.ma.masked_array(np.ones((3, 3)), mask=False)
    np.testing.assert_array_equal(field("gap_voltages", whole).gap_voltages, np.ones((3, 3)))


def scans_of_three() -> Any:
    return posor.Scans.from_fields(**SCANS)


def field(name: object, values: object) -> Any:
    return scans_of_three().with_fields({name: values})


def fit(data: object = None, **arguments: Any) -> Any:
    data = scans_of_three() if data is None else data
    return posor_calibration.fit("zero_drift", CALIBRATION, data, **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(("call", "what", "expected"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_a_refusal_says_what_was_wrong_and_what_is_right(call: Callable[[], Any], what: str, expected: str) -> None:
    with pytest.raises((posor.ParameterError, posor.ShapeError)) as caught:
        call()
    assert what in caught.value.what
    assert expected in caught.value.expected
    assert caught.value.where


@pytest.mark.parametrize("sigma", [np.array(1e-6), np.float32(1e-6), 1e-6, [1e-6] * 3])
def test_an_uncertainty_is_any_real_number(sigma: Any) -> None:
    with pytest.raises(posor.PosorError) as caught:
        fit(references={"/cmm": np.zeros((3, 3))}, uncertainties={"/cmm": sigma})
    assert not isinstance(caught.value, posor.ParameterError)


def test_a_fit_in_memory_and_of_a_file_are_the_same(tmp_path: Path) -> None:
    poses = [
        pin.SE3(rotation_from_native(4e-3 * np.sin(n), 3e-3 * np.cos(n), 0.0), POSES[0].translation) for n in range(40)
    ]
    rows = np.array([pin.SE3ToXYZQUAT(pose) for pose in poses])
    scans = posor.simulate(CALIBRATION, poses, rate=10.0, seed=3)

    def fit(calibration: posor.Calibration | Path, reference: Any = rows) -> posor_calibration.FitResult:
        return posor_calibration.fit(
            "zero_drift", calibration, scans, references={"/cmm": reference}, uncertainties={"/cmm": (1e-6, 1e-6)}
        )

    found = fit(CALIBRATION)
    track = posor_calibration.Track(scans.stamps_ns.tolist(), rows.tolist(), [0.0] * 7, "cmm")  # type: ignore[arg-type]
    np.testing.assert_array_equal(fit(CALIBRATION, track).covariances[0].matrix, found.covariances[0].matrix)
    track = posor_calibration.Track(scans.stamps_ns, 2.0 * rows, np.zeros(7), "cmm")
    with pytest.raises(posor.PosorError, match="cmm: rotation 1 has the length 2; expected a unit quaternion"):
        fit(CALIBRATION, track)
    found.save(tmp_path / "new.yaml")
    assert "zero_drift" in repr(found)
    assert len(found.covariances[0].matrix) == len(found.covariances[0].entries)
    assert not found.covariances[0].matrix.flags.writeable
    [record] = posor.load_calibration(tmp_path / "new.yaml").fits
    assert record.instruments[0].topic == "/cmm"
    again = fit(tmp_path / "new.yaml")
    assert len(again.calibration.fits) == 2
    with pytest.raises(posor.CalibrationError):
        again.save(tmp_path / "new.yaml")
    again.save(tmp_path / "new.yaml", force=True)
    assert posor.load_calibration(tmp_path / "new.yaml").content_hash == again.calibration.content_hash

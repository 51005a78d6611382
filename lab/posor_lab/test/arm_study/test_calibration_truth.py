# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrated arms against the independent truth: a few in CI, ``make calibration-truth`` calibrates many."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
import yaml
from posor.bags.offline_pipeline import load_arm
from posor.chain.arm_file import load_arm_file
from posor.errors import PosorError
from posor.numerics.array_types import FloatArray
from posor.numerics.stamps import NS
from posor.ros_names import TEMPERATURE
from posor_bringup.calibrate_arm_command import main as calibrate
from posor_calibration.arm.arm_files import Provenance, make_files, plain_endpoints
from posor_calibration.arm.arm_fit import ArmProblem, Tool, calibrate_arm
from posor_calibration.arm.arm_model import ArmModel, ArmStates
from posor_calibration.arm.arm_poses import poses_at
from posor_calibration.arm.endpoint_references import EndpointReferences, Reading
from posor_lab.arm_study.calibration_truth import (
    REFLECTORS,
    TOOL_SIGMA,
    CalibrationTruth,
    Consistency,
    write_assembled_arm,
)
from posor_lab.arm_study.calibration_truth_command import main
from posor_lab.arm_study.statement_truth import DrawnArm
from posor_lab.arm_study.tracker_recording import write_calibration_recording
from posor_lab.harness.certificates import CERTIFICATE, numbers, quantities, read_dcc
from posor_lab.harness.full_disk import contents_of, full_disk_changes_nothing
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.optimize import least_squares

USED, TESTED, ARMS = 40, 6, 2
TOOLS = {name: Tool(pin.SE3(np.eye(3), np.array(place)), (TOOL_SIGMA, 0.1)) for name, place in REFLECTORS.items()}


class Case(NamedTuple):
    """An arm by its files, one drawn arm, and what a tracker reads of it."""

    path: Path
    truth: CalibrationTruth
    drawn: DrawnArm
    states: ArmStates
    references: EndpointReferences

    def problem(self, readings: Sequence[Reading]) -> ArmProblem:
        return ArmProblem(self.truth.model, self.states, replace(self.references, readings=tuple(readings)), TOOLS)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    path = write_assembled_arm(load_arm_file("five_axis"), tmp_path_factory.mktemp("assembled"))
    truth = CalibrationTruth(path, USED, TESTED, 5)
    drawn = truth.draw(range(7, 8))[0]
    references, _ = truth.readings(drawn, np.random.default_rng(11))
    return Case(path, truth, drawn, truth.states(drawn, 0), references)


def shifted(rows: Sequence[int], reflector: str, shift: float) -> Callable[[Reading], Reading]:
    """Return a change of the readings of a reflector at some poses; an empty name: of all reflectors."""

    def change(reading: Reading) -> Reading:
        hit = reading.reflector in (reflector or reading.reflector) and reading.pose in rows
        return reading._replace(values=reading.values + shift) if hit else reading

    return change


def only_first(reading: Reading) -> Reading | None:
    return reading if reading.pose < 1 else None


def scaled(reading: Reading) -> Reading:
    return reading._replace(values=reading.values * np.array([1.0, 1.0, 1.002]))


def test_errors_at_other_poses_are_of_the_stated_size(case: Case) -> None:
    outcomes = case.truth.outcomes(range(1, 1 + ARMS))
    found = Consistency.of(outcomes)
    assert found.in_band, found
    assert found.after_rms < 0.5 * found.before_rms
    smaller = [each._replace(errors=3.0 * each.errors, squares=9.0 * each.squares) for each in outcomes]
    assert not Consistency.of(smaller).in_band


def test_a_tracker_that_is_worse_than_stated_leaves_errors_of_the_stated_size(case: Case) -> None:
    random, outcomes = np.random.default_rng(5), []
    for draw, drawn in zip(range(1, 1 + ARMS), case.truth.draw(range(1, 1 + ARMS)), strict=True):
        references, true = case.truth.readings(drawn, np.random.default_rng([draw, 2]))
        worse = [
            each._replace(values=each.values + 6.0 * each.sigmas * random.normal(size=3))
            for each in references.readings
        ]
        outcomes.append(case.truth.outcome(drawn, replace(references, readings=tuple(worse)), true))
    assert all(5.0 < each.calibration.spread < 7.0 for each in outcomes)
    assert Consistency.of(outcomes).in_band


def test_the_written_files_and_the_plain_urdf_alone_reproduce_the_endpoint(case: Case) -> None:
    problem, poses = case.problem(case.references.readings), case.truth.measured(case.drawn, 0)
    found = calibrate_arm(problem, ())
    files = make_files(load_arm_file(case.path), problem, found, poses, Provenance("2026-01-01T00:00:00Z", {}))
    assert files.files.largest < 5e-6  # shared errors vary from pose to pose
    assert 1.0 <= files.enlarged < 2.0
    values = dict(zip((each.name for each in found.parameters), found.values, strict=True))
    plain = plain_endpoints(files.texts["controller.urdf"], "endpoint", problem.model.joints, poses.angles)
    errors = []
    for reading in problem.readings:
        tool = REFLECTORS[reading.reflector] + np.array([values[f"tool {reading.reflector} {axis}"] for axis in "xyz"])
        errors.append((files.T_reference_base * plain[reading.pose]).act(tool) - reading.values)
    rms = np.sqrt(np.mean(np.square(np.linalg.norm(errors, axis=1))))
    assert rms < 1.2 * found.after["used"].position < found.before["used"].position


def test_one_outlier_in_twenty_is_left_out_by_name(case: Case) -> None:
    wrong = range(3, USED, 7)
    change = shifted(wrong, "smr2", 1e-3)
    found = calibrate_arm(case.problem([change(each) for each in case.references.readings]), ())
    assert set(found.outliers) == {f"row {n + 1} of smr2" for n in wrong}
    assert found.spread < 1.3


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (shifted(range(30, USED), "smr1", 5e-4), r"all 10 readings after row 30 of smr1 .* has 'smr1' moved\?"),
        (shifted(range(8), "smr3", 5e-4), r"all 8 readings before row 9 of smr3 .* has 'smr3' moved\?"),
        (
            shifted(range(20, USED), "", 4e-4),
            r"after row 20 of smr3 are off by \+0\.[34].*, \+0\.[34].*, \+0\.[34].* mm .*has the tracker or the base",
        ),
        (only_first, r"9 numbers at 1 poses for 15 unknowns"),
        (scaled, r"(is .* off; expected at most 10 times|readings disagree|times as large)"),
    ],
    ids=["moved late", "moved early", "tracker moved", "too few", "another scale"],
)
def test_readings_that_contradict_each_other_or_the_arm_are_refused(
    case: Case, change: Callable[[Reading], Reading | None], sentence: str
) -> None:
    readings = [each for each in map(change, case.references.readings) if each is not None]
    with pytest.raises(PosorError, match=sentence):
        calibrate_arm(case.problem(readings), ())


def seat_angles(case: Case, count: int) -> FloatArray:
    """Return angles at which the endpoint is at one place."""
    chain, random = case.truth.model.chain, np.random.default_rng(8)
    names = case.truth.model.joints

    def place(angles: FloatArray) -> FloatArray:
        return np.asarray(chain.nominal_endpoint(dict(zip(names, angles, strict=True))).translation)

    middle = np.array([0.2, -0.4, 0.8, 0.3, 0.4])
    seat, starts = place(middle), middle + random.uniform(-0.5, 0.5, (2 * count, len(names)))

    def distance(angles: FloatArray) -> FloatArray:
        return place(angles) - seat

    found = [np.asarray(least_squares(distance, start).x) for start in starts]
    reached = [q for q in found if np.linalg.norm(place(q) - seat) < 1e-6 and np.abs(q).max() < 1.5]
    return np.array(reached[:count]) + 3e-6 * random.normal(size=(len(reached[:count]), len(names)))  # as measured


@pytest.mark.parametrize("kind", ["one seat", "ball bar"])
def test_lengths_from_a_fixed_ball_determine_beams(case: Case, kind: str) -> None:
    bar = kind == "ball bar"
    model, poses = case.truth.model, case.truth.measured(case.drawn, 0)
    calibrations = {name: load_arm_file(case.path).calibration(name) for name in model.joints}
    if not bar:
        poses = poses_at(model.chain, calibrations, seat_angles(case, 20))
        model = ArmModel(model.chain, calibrations, poses)
    states = model.states(poses, model.effects_at(poses))
    ends = [end.translation for end in model.move(states, 0.0 * model.prior[0], pin.SE3.Identity()).endpoints]
    lengths = [float(np.linalg.norm(end - np.mean(ends, axis=0))) if bar else 0.0 for end in ends]
    sigmas = np.full(1 if bar else 3, 1e-5)
    readings = [
        Reading(f"row {n + 1} of ball", n, "ball", "distance", np.array([length]), None, sigmas)
        for n, length in enumerate(lengths)
    ]
    if bar:
        readings[4] = readings[4]._replace(values=readings[4].values + 1e-3)
    references = EndpointReferences(np.arange(len(ends)), np.arange(len(ends)) + 1, tuple(readings), {})
    found = calibrate_arm(ArmProblem(model, states, references, {"ball": Tool(pin.SE3.Identity(), (1e-3, 0.1))}), ())
    assert found.outliers == (("row 5 of ball",) if bar else ())
    assert np.abs(found.values[:6]).max() < 1e-8  # the frame is that of the base
    remaining = [sigma / each.sigma for each, sigma in zip(found.parameters, found.sigmas, strict=True)]
    assert min(ratio for each, ratio in zip(found.parameters, remaining, strict=True) if "upper_arm" in each.name) < 0.6


@pytest.mark.parametrize(("scale", "word"), [(1.0, ""), (1.0005, "longer"), (0.9995, "shorter")])
def test_a_wrong_scale_of_all_references_is_a_warning(case: Case, scale: float, word: str) -> None:
    readings = [each._replace(values=scale * each.values) for each in case.references.readings]
    warnings = [each for each in calibrate_arm(case.problem(readings), ()).warnings if "the scale of" in each]
    assert len(warnings) == bool(word)
    assert all(f" µm/m {word} than the files state" in each for each in warnings)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    write_calibration_recording(load_arm_file("five_axis"), folder, 7, 3)
    return folder


def options(folder: Path, table: str = "tracker.csv") -> list[str]:
    uncertain = [word for name in REFLECTORS for word in ("--uncertainty", f"{name}=15e-6,6e-6")]
    tools = [word for name, p in REFLECTORS.items() for word in ("--tool", f"{name}={p[0]},{p[1]},{p[2]}")]
    files = ["--bag", str(folder / "bag"), "--table", str(folder / table), "--map", str(folder / "map.yaml")]
    return [str(folder / "arm.yaml"), *files, *uncertain, *tools, "--tool-uncertainty", "1e-3,0.1"]


def test_the_program_writes_an_arm_that_can_be_used_and_replaces_nothing(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, lab = ["--output", str(tmp_path / "new")], tmp_path / "lab.yaml"
    lab.write_text(CERTIFICATE, encoding="utf-8")
    dcc = ["--dcc", str(tmp_path / "dcc.xml"), "--certificate", str(lab)]
    assert calibrate([*options(recorded), *output, *dcc]) == 0
    content = json.loads((tmp_path / "new" / "arm_calibration.json").read_text(encoding="utf-8"))
    assert content["after"]["held out"]["position"] < 1.5 * content["before"]["held out"]["position"]
    assert str(recorded / "tracker.csv") in content["sources"]
    found = quantities(read_dcc(tmp_path / "dcc.xml"))
    for each in content["parameters"]:
        stated = [each["value"], 2.0 * each["standard_uncertainty"], 2.0, 0.9545]
        assert numbers(found[f"change: {each['name']}"]) == stated
    arm = load_arm_file(tmp_path / "new" / "arm.yaml")
    assert arm.chain().links[1].T_nominal != load_arm_file(recorded / "arm.yaml").chain().links[1].T_nominal
    before = contents_of(tmp_path / "new")
    for place in (output, ["--output", str(recorded)]):
        assert calibrate([*options(recorded), *place]) == 1
        assert "exists already; expected another name, or --force" in capsys.readouterr().err
    assert before == contents_of(tmp_path / "new")
    with full_disk_changes_nothing(tmp_path / "new", len(before["arm_calibration.json"]) // 2):
        assert calibrate([*options(recorded), *output, "--force"]) == 1
    assert "arm_calibration.json: cannot be written: File too large" in capsys.readouterr().err
    assert calibrate([*options(recorded), *output, "--force"]) == 0
    after = contents_of(tmp_path / "new")
    assert {name: after[f"{name}.1"] for name in before} == before
    assert len(after) == 2 * len(before)
    capsys.readouterr()
    again = [str(tmp_path / "new" / "arm.yaml"), *options(recorded)[1:], "--output", str(tmp_path / "again")]
    assert calibrate(again) == 1
    assert "beams.yaml is already calibrated by it; expected the arm file from before" in capsys.readouterr().err


WARMER_K, COEFFICIENT, WARM_BEAMS = 5.0, 23e-6, ("upper_arm", "forearm")


def write_warm_arm(recorded: Path, folder: Path) -> None:
    """Write the same arm by files that state two beams shorter at 20 °C, and thermometers that read 25 °C."""
    shutil.copytree(recorded, folder)
    shutil.rmtree(folder / "bag")
    factor = 1.0 + COEFFICIENT * WARMER_K
    arm, urdf, beams = folder / "arm.yaml", load_arm_file(recorded / "arm.yaml").urdf, folder / "beams.yaml"
    tree = ET.parse(urdf)  # noqa: S314  a file of the project
    for joint in tree.getroot().iter("joint"):
        if joint.get("name") in WARM_BEAMS and (origin := joint.find("origin")) is not None:
            origin.set("xyz", " ".join(str(float(each) / factor) for each in origin.get("xyz", "").split()))
    tree.write(folder / "warm.urdf", encoding="unicode")
    text = arm.read_text(encoding="utf-8").replace(str(urdf), str(folder / "warm.urdf"))
    arm.write_text(text.replace(str(recorded), str(folder)), encoding="utf-8")
    content = yaml.safe_load(beams.read_text(encoding="utf-8"))
    numbers_in = {"reference": (293.15, "K"), "uncertainty": (0.05, "K"), "rate": (0.01, "K/s"), "age": (10.0, "s")}
    for beam in content["beams"]:
        if beam["joint"] in WARM_BEAMS:
            entry = {key: {"value": value, "unit": unit} for key, (value, unit) in numbers_in.items()}
            entry |= {"name": beam["joint"], "range": {"value": [278.15, 308.15], "unit": "K"}}
            beam["temperature"] |= {"spread": {"value": 1.0, "unit": "K"}, "thermometer": entry}
            for plate in beam["sag"]["plates"]:
                plate["at"]["value"] /= factor if plate["at"]["value"] > 0.0 else 1.0
    beams.write_text(yaml.safe_dump(content), encoding="utf-8")


def write_warm_bag(recorded: Path, folder: Path) -> None:
    """Copy a bag, and add readings of the thermometers, twice a second."""
    types, names = get_typestore(Stores.ROS2_JAZZY), dict[str, Any]()
    classes = [types.types[f"{each}"] for each in (TEMPERATURE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")]
    temperature, header, time = classes
    with (
        Reader(recorded / "bag") as reader,
        Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag,
    ):
        for each in reader.connections:
            names[each.topic] = bag.add_connection(
                each.topic, each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest
            )
        rows = [(ns, names[each.topic], bytes(data)) for each, ns, data in reader.messages()]
        for beam in WARM_BEAMS:
            to = bag.add_connection(f"/five_axis/temperature/{beam}", TEMPERATURE, typestore=types)
            for n, ns in enumerate(range(reader.start_time - 3 * NS, reader.end_time + NS, NS // 2)):
                stamp = header(stamp=time(sec=ns // NS, nanosec=ns % NS), frame_id=beam)
                reading = temperature(header=stamp, temperature=20.0 + WARMER_K + 0.01 * (n % 3), variance=0.0)
                rows.append((ns, to, bytes(types.serialize_cdr(reading, TEMPERATURE))))
        for ns, to, data in sorted(rows, key=lambda row: row[0]):
            bag.write(to, ns, data)


def test_beams_are_calibrated_at_the_temperatures_of_their_thermometers(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    warm = tmp_path / "warm"
    write_warm_arm(recorded, warm)
    write_warm_bag(recorded, warm)
    paths = []
    for folder in (recorded, warm):
        assert calibrate([*options(folder), "--output", str(tmp_path / folder.name / "new")]) == 0
        end = load_arm(tmp_path / folder.name / "new" / "arm.yaml").estimate(folder / "bag").endpoint
        paths.append(end.poses[:: len(end) // 50, :3])
    distances = [np.linalg.norm(path[:, None] - path, axis=2) for path in paths]
    assert np.ptp(distances[0]) > 0.3
    np.testing.assert_allclose(distances[1], distances[0], rtol=0.0, atol=2e-6)  # 80 um without the temperatures
    shutil.rmtree(warm / "bag")
    shutil.copytree(recorded / "bag", warm / "bag")
    capsys.readouterr()
    assert calibrate([*options(warm), "--output", str(tmp_path / "none")]) == 1
    assert "thermometer 'upper_arm' of beam 'upper_arm' cannot be used at row 1; expected" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("row", "later", "sentence"),
    [
        (-1, 1000.0, r"no usable scan within 0\.1 s of row 7"),
        (1, -1.4, r"moves by .* at row 1; expected an arm at rest"),
    ],
    ids=["another clock", "in motion"],
)
def test_rows_without_an_arm_at_rest_are_refused(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], row: int, later: float, sentence: str
) -> None:
    lines = (recorded / "tracker.csv").read_text(encoding="utf-8").splitlines()
    time, *others = lines[row].split(";")
    lines[row] = ";".join([f"{float(time) + later:.3f}", *others])
    table = recorded / f"{later}.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert calibrate([*options(recorded, table.name), "--output", str(tmp_path / "new")]) == 1
    assert re.search(sentence, capsys.readouterr().err)


def test_rows_that_use_the_same_scans_are_refused(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (recorded / "tracker.csv").read_text(encoding="utf-8").splitlines()
    time, *others = lines[1].split(";")
    lines.insert(2, ";".join([f"{float(time) + 1e-3:.3f}", *others]))
    table = recorded / "twice.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert calibrate([*options(recorded, table.name), "--output", str(tmp_path / "new")]) == 1
    assert "rows 1 and 2 are 0.001 s apart and use the same scans; expected one row" in capsys.readouterr().err


def test_the_program_selects_poses_that_determine_more(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = "base_swivel,shoulder,elbow,wrist_roll,wrist_yaw"
    rows = ["0.1,0.1,0.1,0.1,0.1"] * 3 + ["0.5,-0.6,0.7,-0.4,0.6", "-0.5,0.3,0.9,0.6,-0.7"]
    path = tmp_path / "candidates.csv"
    path.write_text("\n".join([names, *rows]) + "\n", encoding="utf-8")
    assert calibrate(["five_axis", "--select", "3", "--candidates", str(path), "--uncertainty", "ball=1e-6"]) == 0
    printed = capsys.readouterr().out.split()
    assert printed[0] == names
    assert set(rows[2:]) == set(printed[1:])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "--bag and --table and --map missing"),
        (["--select", "3"], "--candidates missing"),
        (["--select", "3", "--candidates", "c", "--dcc", "d"], "--dcc with --select; expected --select alone"),
        (["--bag", "b", "--table", "t", "--map", "m", "--hold-out", "1"], "no pose would be used"),
        (["--select", "3", "--candidates", "c", "--uncertainty", "ball"], "expected NAME="),
        (["--select", "3", "--candidates", "c", "--tool", "ball=1,2"], "expected 3 or 6 numbers"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(["five_axis", *arguments]) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.long
def test_the_program_writes_its_figures(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    assert main(["--arms", "20", "--tested", "40", "--output", str(path)]) == 0
    assert json.loads(path.read_text(encoding="utf-8"))["arms"] == 20

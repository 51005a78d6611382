# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor arm new and posor arm check: a new arm is right, and all mistakes of an arm are reported at once."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from posor.calibration.calibration_file import load_calibration
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError, OutputError, PosorError, SeveralErrors
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor_bringup.arm_files_command import main
from posor_bringup.arms import check_arm
from posor_bringup.new_arm import SENSORS, Axis, Sensors, arm_texts, new_joints, write_arm
from posor_drivers.instruments.calibrated_readings import check_readings
from posor_drivers.instruments.instruments_command import main as instruments
from posor_drivers.instruments.instruments_file import JointEntry
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.harness.case_tables import edited, refusal
from posor_lab.harness.full_disk import contents_of, file_size_limit
from posor_lab.harness.rig_files import share

MISTAKES = yaml.safe_load(Path(__file__).with_name("arm_mistakes.yaml").read_text(encoding="utf-8"))
LENGTHS = (0.5, 0.3, 0.2)


def make_arm(folder: Path, sensors: Sensors = "bumpy_ring", count: int = 3) -> Path:
    axes: list[Axis] = ["z", "y", "x"]
    names = [f"joint{n + 1}" for n in range(count)]
    joints = new_joints(names, axes[:count], LENGTHS[:count], [sensors] * count)
    write_arm(folder, arm_texts("own", joints, str(folder)))
    return folder


def change(folder: Path, file: str, old: str, new: str) -> None:
    path = folder / file
    path.write_text(edited(path.read_text(encoding="utf-8"), old, new), encoding="utf-8")


def sentences(folder: Path, **options: object) -> list[str]:
    with pytest.raises(PosorError) as caught:
        check_arm(str(folder), **options)  # type: ignore[arg-type]
    return [str(part) for part in caught.value.parts]


@pytest.mark.parametrize("sensors", SENSORS)
def test_a_new_arm_is_right_and_its_scans_have_poses(sensors: Sensors, tmp_path: Path) -> None:
    checked = check_arm(str(make_arm(tmp_path / "own", sensors)))
    endpoint = checked.chain.nominal_endpoint(dict.fromkeys(checked.calibrations, 0.0))
    assert endpoint.translation == pytest.approx([sum(LENGTHS), 0.0, 0.0], abs=1e-12)
    assert endpoint.rotation == pytest.approx(np.eye(3), abs=1e-12)
    simulation = ArmSimulation(checked.arm)
    joint, calibration = next(iter(checked.calibrations.items()))
    scans = simulation.scans(joint, np.arange(600)).scans
    states = Posor(calibration).estimate_all(scans).states
    assert np.mean(np.isin(states, [State.OK, State.DEGRADED])) > 0.98  # a few are dark, or before the home mark


def test_the_urdf_of_a_robot_takes_the_place_of_the_made_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_arm(tmp_path / "own", "light_ring", 2)
    links = ("base_link", "shoulder_link", "upper_arm_link", "gripper_link")
    ends = [f'<parent link="{parent}"/><child link="{child}"/>' for parent, child in pairwise(links)]
    parts = [f'<link name="{link}"/>' for link in links]
    parts += [
        f'<joint name="joint1" type="floating">{ends[0]}<axis xyz="0 0 1"/><origin xyz="0 0 0.089"/></joint>',
        f'<joint name="joint2" type="floating">{ends[1]}<axis xyz="0 -1 0"/><origin xyz="0 0 0.038"/></joint>',
        f'<joint name="tool" type="fixed">{ends[2]}<origin xyz="0.2 0 0.1"/></joint>',
    ]
    (folder / "own.urdf").write_text(f'<robot name="own">{"".join(parts)}</robot>', encoding="utf-8")
    change(folder, "arm.yaml", "beams: beams.yaml\n", "")
    change(folder, "arm.yaml", "endpoint_frame: endpoint", "endpoint_frame: gripper_link")
    assert main(["check", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "endpoint with all angles zero: 0.2000, 0.0000, 0.2270 m in base_link" in printed
    assert "gravity: along -Z of base_link, the arm stands" in printed
    assert "protection level of the endpoint, all angles zero: finite" in printed  # so all readings are in their range


def test_the_direction_of_gravity_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make_arm(tmp_path / "own", "light_ring", 2)
    directions = {"[0.0, 0.0, 9.8]": "+Z of base, the arm hangs", "[0.0, -9.8, 0.0]": "-Y of base, the base is on"}
    for value, line in directions.items():
        text = (folder / "beams.yaml").read_text(encoding="utf-8")
        text = "".join(each for each in text.splitlines(keepends=True) if not each.startswith("gravity"))
        (folder / "beams.yaml").write_text(f"{text}gravity: {{value: {value}, unit: m/s^2}}\n", encoding="utf-8")
        assert main(["check", str(folder)]) == 0
        assert f"gravity: along {line}" in capsys.readouterr().out


def test_options_choose_axes_lengths_sensors_and_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    own = ["--axes", "y", "--lengths", "0.4,0.25", "--sensors", "diodes,bumpy_ring", "--names", "upper,lower"]
    assert main(["new", "two", "--joints", "2", *own]) == 0
    assert main(["check", "two"]) == 0
    printed = capsys.readouterr().out
    assert "joint upper: gap_probes, diodes (4 gap voltages, 8 diode currents, 2 lit sources)" in printed
    assert "joint lower: gap_probes, bumpy_ring" in printed
    assert "nominal reach: 0.65" in printed
    assert "200 scans per second" in printed
    assert "not finite" in printed  # two diodes and no dark scans do not show every cause
    before = contents_of(Path("two"))
    assert main(["new", "two", "--joints", "1"]) == 1
    assert capsys.readouterr().err == "two: exists already; expected another name, or --folder.\n"
    assert contents_of(Path("two")) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["two"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["2nd", "--joints", "2"], "name '2nd'; expected a letter"),
        (["own", "--joints", "0"], "argument --joints: "),
        (["own", "--joints", "3", "--axes", "z,y"], "--axes: 'z,y'; expected 1 or 3: x, y, z"),
        (["own", "--joints", "2", "--sensors", "bumpy"], "--sensors: 'bumpy'; expected 1 or 2: light_ring"),
        (["own", "--joints", "2", "--lengths", "300"], "--lengths: '300'; expected 1 or 2: lengths of 0.1 to 3 m"),
        (["own", "--joints", "2", "--names", "a,a"], "--names: 'a,a'; expected 2 different names"),
    ],
)
def test_wrong_options_of_a_new_arm_are_one_sentence(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", *arguments, "--folder", str(tmp_path / "own")]) == 2
    assert expected in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_left_as_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with file_size_limit(3000):
        assert main(["new", "own", "--joints", "1", "--folder", str(tmp_path / "own")]) == 1
    assert capsys.readouterr().err == f"{tmp_path / 'own'}: cannot be written, File too large.\n"
    (tmp_path / "file").touch()
    assert refusal(OutputError, write_arm, tmp_path / "file" / "own", {"arm.yaml": ""}).where == str(
        tmp_path / "file" / "own"
    )
    with pytest.raises(UnicodeEncodeError):
        write_arm(tmp_path / "own", {"arm.yaml": "", "beams.yaml": "\udc80"})
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_all_mistakes_of_an_arm_are_reported_at_once(tmp_path: Path) -> None:
    """Each row of the table is a mistake; the arm has all of them, and each sentence names its place."""
    folder = make_arm(tmp_path / "own")
    for row in MISTAKES:
        change(folder, row["file"], row["old"], row["new"])
    found = sentences(folder)
    patterns = [
        rf"{re.escape(str(folder / row['file']))}, line \d+.*{sentence}" for row in MISTAKES for sentence in row["says"]
    ]
    assert [each for each in patterns if not any(re.search(each, sentence) for sentence in found)] == []
    assert len(found) == len(patterns), found


def test_mistakes_of_an_invalid_arm_file_and_of_the_files_that_it_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_arm(tmp_path / "own")
    change(folder, "arm.yaml", "urdf: own.urdf", "urdff: own.urdf")
    change(folder, "arm.yaml", "name: own ", "name: 1own ")
    change(folder, "arm.yaml", "version: 1", "version: 1\nspeed: 3")
    change(folder, "beams.yaml", "version: 2", "version: 7")
    (folder / "calibrations" / "joint2.yaml").unlink()
    assert main(["check", str(folder)]) == 1
    found = capsys.readouterr().err.splitlines()
    assert len(found) == 5
    for part in ("line 10, key speed", "key urdff", "key name", "beams.yaml, line", "joint2.yaml: cannot be read"):
        assert any(part in each for each in found), part


def test_driver_parameters_are_checked_with_the_command_line(tmp_path: Path) -> None:
    folder = make_arm(tmp_path / "own", count=1)
    found = sentences(folder, driver_parameters={"simulated.sagg": False, "loop": True})
    assert [each.partition(",")[0].partition(":")[0] for each in found] == [
        "option -p loop",
        "option -p simulated.sagg",
    ]
    assert "one of" in sentences(folder, driver_parameters={"source": "nowhere"})[0]
    (missing,) = sentences(folder, driver_parameters={"source": "bag", "bag.path": str(tmp_path / "no_bag")})
    assert "no_bag" in missing
    assert check_arm(str(folder), driver_parameters={"simulated.rate": 100}).scans_per_second == 100
    assert check_arm(str(folder), drivers=False).programs[-1].executable == "posor_node"


def test_an_arm_of_several_joints_is_not_restamped(tmp_path: Path) -> None:
    """Each driver would begin at a time of its own, and the arm would have no endpoint."""
    replay = {"source": "bag", "bag.path": str(tmp_path / "no_bag"), "restamp": True}
    (refused,) = sentences(make_arm(tmp_path / "two", count=2), driver_parameters=replay)
    what = "restamp: true with 2 joints, which need common stamps; expected false, for the recorded stamps."
    assert refused == f"option -p restamp, node driver_node: {what}"
    (allowed,) = sentences(make_arm(tmp_path / "one", count=1), driver_parameters=replay)
    assert "no_bag" in allowed


def test_the_line_on_the_drivers_is_of_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make_arm(tmp_path / "own", count=1)
    for options, line in (([], "source simulated, "), (["-p", "simulated.rate:=100"], "100 scans per second")):
        assert main(["check", str(folder), *options]) == 0
        assert line in next(each for each in capsys.readouterr().out.splitlines() if each.startswith("driver: "))
    assert main(["check", str(folder), "--no-driver"]) == 0
    assert "driver: " not in capsys.readouterr().out


def test_sections_of_parameter_files_name_nodes_of_the_arm(tmp_path: Path) -> None:
    folder, file = make_arm(tmp_path / "own", count=1), tmp_path / "parameters.yaml"
    sections = {"/own/chain_node": {"tf_rate": 5.0}, "/own/*/posor_node": {"limits": {"latency": 0.5}}}
    file.write_text(yaml.safe_dump({name: {"ros__parameters": each} for name, each in sections.items()}))
    chain, posor, _ = check_arm(str(folder), parameter_files=[file]).programs
    assert (chain.parameters["tf_rate"], posor.parameters["limits.latency"]) == (5.0, 0.5)
    sections["/own/joint1/driver_node"] = {"simulated.sag": False}
    file.write_text(yaml.safe_dump({name: {"ros__parameters": each} for name, each in sections.items()}))
    assert len(check_arm(str(folder), drivers=False, parameter_files=[file]).programs) == 2
    file.write_text("chain_node:\n  ros__parameters: {tf_rate: 5.0}\n/**:\n  ros__parameters: {lossles: true}\n")
    found = sentences(folder, parameter_files=[file])
    assert found[0] == (
        f"{file}, line 1, key chain_node: no node of the arm is called '/chain_node'; "
        "expected perhaps '/own/chain_node'."
    )
    assert len(found) == 4  # and a misspelt parameter of three nodes
    assert f"{file}, line 4, key /**.ros__parameters.lossles" in found[1]


@pytest.fixture
def instrument_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Make an arm of two joints with the instruments file i.yaml."""
    folder = make_arm(tmp_path / "own", count=2)
    source = "source: instruments\n  parameters: {instruments.file: '{folder}/i.yaml', instruments.joint: '{joint}'}\n"
    change(folder, "arm.yaml", "source: simulated ", source)
    assert instruments(["start", str(folder / "arm.yaml")]) == 0
    (folder / "i.yaml").write_text(capsys.readouterr().out, encoding="utf-8")
    return folder


def test_an_instruments_file_is_compared_with_the_calibrations(instrument_arm: Path) -> None:
    folder = instrument_arm
    programs = check_arm(str(folder)).programs
    assert len(programs) == 5
    topics = [each.parameters["instruments.temperature_topic"] for each in programs if each.executable == "driver_node"]
    assert topics == ["/own/temperature"] * 2
    content = yaml.safe_load((folder / "i.yaml").read_text(encoding="utf-8"))
    del content["joints"]["joint1"]["gap_voltages"][1]
    content["joints"]["joint1"]["frame_id"] = "elsewhere"
    content["joints"]["joint3"] = content["joints"].pop("joint2")
    (folder / "i.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    found = sentences(folder)
    assert [each for each in found if "3 gap_voltages; expected 4" in each]
    assert [each for each in found if "frame_id 'elsewhere'; expected 'joint1_receiving'" in each]
    assert [each for each in found if "'joint2' is not a joint of" in each]
    assert len(found) == 3


def test_a_light_source_that_the_calibration_does_not_have_is_refused() -> None:
    gaps = [{"channel": f"box/gap{n}"} for n in range(3)]
    currents = [{"channel": f"box/current{n}"} for n in range(8)]
    readings = {"gap_voltages": gaps, "diode_currents": currents, "lit_sources": [1, 2]}
    entry = JointEntry.model_validate({"frame_id": "joint1_receiving", **readings})
    calibration = load_calibration(share() / "arms/test_rig/calibrations/joint1.yaml")
    error = refusal(CalibrationError, check_readings, entry, calibration, "i.yaml")
    assert str(error) == "i.yaml: light source 2; expected 0 to 1."


def test_thermometers_of_an_instruments_file_are_compared_with_the_beams_file(instrument_arm: Path) -> None:
    folder = instrument_arm
    content = yaml.safe_load((folder / "i.yaml").read_text(encoding="utf-8"))
    channels = {f"heat{n}": {"unit": "V", "scale": 1.0} for n in range(2)}
    device = next(iter(content["devices"]))
    content["devices"][device]["channels"] |= channels
    content["devices"][device]["fields"] += list(channels)
    content["devices"][device]["format"] += "dd"
    kelvins = {"scale": {"value": 1.0, "unit": "K/V"}, "offset": {"value": 273.15, "unit": "K"}}
    content["thermometers"] = {
        name: {"joint": "joint1", "channel": f"{device}/heat{n}", **kelvins} for n, name in enumerate(("hot", "cold"))
    }
    (folder / "i.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    limits = "range: {value: [280, 310], unit: K}, rate: {value: 0.01, unit: K/s}, age: {value: 10, unit: s}"
    plate = "  - {{joint: {}, thermometer: {{name: {}, uncertainty: {{value: 0.1, unit: K}}, {}}}}}\n"
    beams = (folder / "beams.yaml").read_text(encoding="utf-8").replace("version: 2", "version: 3")

    def found(*plates: tuple[str, str]) -> list[str]:
        text = beams + "plates:\n" + "".join(plate.format(joint, name, limits) for joint, name in plates)
        (folder / "beams.yaml").write_text(text, encoding="utf-8")
        return sentences(folder)

    (unread,) = found(("joint1", "hot"))
    assert "key thermometers.cold: no beam and no plate has this thermometer" in unread
    (other,) = found(("joint1", "hot"), ("joint2", "cold"))
    assert "joint 'joint1', but 'cold' is on the plate of 'joint2' in the beams file; expected joint: joint2" in other


def test_a_record_of_other_joints_is_refused(tmp_path: Path) -> None:
    folder = make_arm(tmp_path / "own", count=1)
    change(folder, "arm.yaml", "beams: beams.yaml", "beams: beams.yaml\ncommissioning: record.json")
    assert check_arm(str(folder)).arm.commissioning == load_arm_file(folder / "arm.yaml").commissioning
    (folder / "record.json").write_text("{}", encoding="utf-8")
    (found,) = sentences(folder)
    assert "record.json" in found


def test_one_error_keeps_its_kind_and_several_are_one_error(tmp_path: Path) -> None:
    folder = make_arm(tmp_path / "own", count=2)
    path = folder / "calibrations" / "joint1.yaml"
    change(folder, "calibrations/joint1.yaml", "parent: joint1", "parent: jointX")
    assert refusal(PosorError, check_arm, str(folder)).where.startswith(f"{path}, line ")
    assert load_calibration(path).frames.parent == "jointX_receiving"
    change(folder, "calibrations/joint2.yaml", "child: joint2", "child: jointY")
    with pytest.raises(SeveralErrors) as caught:
        check_arm(str(folder))
    assert len(caught.value.parts) == 2

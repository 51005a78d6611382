# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor statement: the three files agree, every origin leads to its line, and what it refuses."""

from __future__ import annotations

import json
import math
import re
import shlex
import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
import yaml
from posor.chain.arm_file import load_arm_file
from posor_bringup.arm_files_command import main as new_arm
from posor_bringup.statement_command import compute_statement, main, parse_options
from posor_design.statement_map import COLOURS, draw_map
from posor_design.statement_report import OUTPUT_FILES, micro_bound, render_sheet, verdict
from posor_lab.harness.full_disk import full_disk_changes_nothing
from posor_lab.harness.report_page import ReportPage
from scipy.stats import t

ROOT = Path(__file__).resolve().parents[4]
ARMS = ROOT / "ros2_ws" / "src" / "posor_bringup" / "arms"
BAG = ROOT / "bags" / "five_axis"
HEADER = "base_swivel,shoulder,elbow,wrist_roll,wrist_yaw"
PATH = f"{HEADER}\n0.4,-0.6,0.9,0.3,-0.5\n0.0,0.0,0.0,0.0,0.0\n0.1,-1.2,1.9,0.0,0.5\n"
REFUSALS = yaml.safe_load(Path(__file__).with_name("statement_refusals.yaml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("statement")
    path = folder / "poses.csv"
    path.write_text(PATH, encoding="utf-8-sig")  # as Excel does
    assert main(["five_axis", "--path", str(path), "--output", str(folder / "deep" / "er")]) == 0
    return folder / "deep" / "er"


def test_the_worst_pose_of_a_path_is_stated_and_its_shares_add_up(made: Path) -> None:
    assert sorted(path.name for path in made.iterdir()) == sorted(OUTPUT_FILES)
    content = json.loads((made / "statement.json").read_text(encoding="utf-8"))
    sizes = {each["name"]: each["largest"] for each in content["map"]}
    assert len(sizes) == 3
    assert content["pose"]["name"] == max(sizes, key=sizes.__getitem__) == "line 3 of poses.csv"
    for group in content["shares"].values():
        assert sum(group.values()) == pytest.approx(1.0, rel=1e-12)
    parts = content["components"]
    assert sum(part["share_of_position"] for part in parts) == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(np.sum([part["shares"] for part in parts], axis=0), 1.0, rtol=1e-12)
    for n, axis in enumerate(content["uncertainty"].values()):
        squares = sum(part["standard_uncertainty"][n] ** 2 for part in parts)
        assert axis["standard"] == pytest.approx(math.sqrt(squares), rel=1e-12)
        assert axis["expanded"] == pytest.approx(axis["coverage_factor"] * axis["standard"], rel=1e-12)
        assert axis["degrees_of_freedom"] is None
        assert axis["coverage_factor"] == pytest.approx(1.959964)
    assert content["position"]["largest"] < content["position"]["semi_axes"][0]


def test_every_origin_leads_to_the_line_that_states_the_number(made: Path) -> None:
    content = json.loads((made / "statement.json").read_text(encoding="utf-8"))
    files = {each["role"]: Path(each["path"]) for each in content["records"]}
    page = ReportPage((made / "statement.html").read_text(encoding="utf-8"))
    assert page.problems == []
    origins = [part["origin"] for part in content["components"]]
    origins += [each["origin"] for each in content["largest_quantities"].values()]
    origins += [each["protection_level_origin"] for each in content["uncertainty"].values()]
    stated = [each["origin"] for each in content["conditions"].values()]
    origins += [each for each in stated if isinstance(each, dict) and each["line"] and each["key"]]
    assert {origin["record"] for origin in origins} >= {"arm file", "beams file", "calibration of elbow"}
    place = {"record": "path", "file": "poses.csv", "line": 3, "key": ""}
    assert content["conditions"]["joint angles"]["origin"] == place
    assert all(stated)
    for origin in origins:
        key = origin["key"].rpartition(".")[2].partition("[")[0]
        line = files[origin["record"]].read_text(encoding="utf-8").splitlines()[origin["line"] - 1]
        assert f"{key}:" in line or line.lstrip().startswith("- ")
        record = list(files).index(origin["record"])
        assert f"record-{record}-{origin['line']}" in page.anchors
    assert len(page.links) >= len({(origin["record"], origin["line"]) for origin in origins[:8]})


def test_page_and_pdf_hold_the_sentences(made: Path) -> None:
    content = json.loads((made / "statement.json").read_text(encoding="utf-8"))
    page = (made / "statement.html").read_text(encoding="utf-8")
    for sentence in (*content["sentences"], *content["reservations"]):
        assert sentence in page
    assert "coverage factor k = 1.96" in page
    assert "<svg" in page
    for record in content["records"]:
        assert record["sha256"] in page
    assert (made / "statement.pdf").read_bytes().startswith(b"%PDF")


def test_rotations_are_stated_as_deviations_from_the_orientation(tmp_path: Path) -> None:
    options = ["five_axis", "--angles=0,-1.5,0,0,0"]  # roll and yaw of this pose are uncertain by more than an axis
    assert main([*options, "--output", str(tmp_path)]) == 0
    page = ReportPage((tmp_path / "statement.html").read_text(encoding="utf-8"))
    quaternion = pin.SE3ToXYZQUAT(compute_statement(parse_options(options)).worst.T_base_endpoint)[3:]
    text = (tmp_path / "statement.html").read_text(encoding="utf-8")
    assert ", ".join(f"{each:.9f}" for each in quaternion) in text
    assert re.search(r"about X</t[dh]>\s*<td[^>]*>\s*0\s*</td>", text)
    assert page.problems == []


def test_a_temperature_deviation_without_a_beam_that_expands_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ARMS / "test_rig", tmp_path / "rig")
    content = yaml.safe_load((tmp_path / "rig/beams.yaml").read_text(encoding="utf-8"))
    for beam in content["beams"]:
        beam.pop("temperature", None)
    (tmp_path / "rig/beams.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    options = [str(tmp_path / "rig/arm.yaml"), "--angles=0", "--output", str(tmp_path / "out")]
    assert main([*options, "--temperature-deviation", "5"]) == 2
    assert capsys.readouterr().err.startswith(
        "option --temperature-deviation: no beam of the arm states how it expands;"
    )
    assert main([*options, "--temperature-deviation", "0"]) == 0


def test_a_full_disk_keeps_all_former_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in OUTPUT_FILES:
        (tmp_path / name).write_text("former", encoding="utf-8")
    with full_disk_changes_nothing(tmp_path, 80_000):  # the page is larger
        assert main(["five_axis", "--angles=0,0,0,0,0", "--output", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"{tmp_path / 'statement.html'}: cannot be written, File too large.\n"


def test_the_map_of_a_workspace_marks_the_worst_pose_and_colours_the_others() -> None:
    statement = compute_statement(parse_options(["six_axis", "--grid", "2"]))
    assert len(render_sheet(statement, "png")) == 1
    assert {round(each.angles["base_turn"], 9) for each in statement.poses} == {0.0, -round(math.pi, 9)}
    circles = [each.attrib for each in ET.fromstring(draw_map(statement)) if each.tag.endswith("circle")]  # noqa: S314
    for ring in (each for each in circles if each["fill"] == "none"):
        there = [each["fill"] for each in circles if (each["cx"], each["cy"]) == (ring["cx"], ring["cy"])]
        assert there[-2] == COLOURS[-1]
    sizes = np.array([each.largest for each in statement.poses])
    lowest = sizes < sizes.min() + (sizes.max() - sizes.min()) / len(COLOURS)
    assert [each["fill"] for each in circles].count(COLOURS[0]) == 2 * np.count_nonzero(lowest)


def test_the_sheet_of_a_long_arm_is_one_page(tmp_path: Path) -> None:
    assert new_arm(["new", "long", "--joints", "14", "--folder", str(tmp_path / "long")]) == 0
    statement = compute_statement(parse_options([str(tmp_path / "long"), "--angles=" + ",".join("0" * 14)]))
    assert len(render_sheet(statement, "png")) == 1


def test_the_bound_that_sets_the_level_leads_to_its_entry(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(ARMS / "test_rig", tmp_path / "rig"))
    (path,) = load_arm_file(folder / "arm.yaml").calibrations.values()
    shared = {"unit": "m", "source": "assumed", "kind": "fault"}
    causes = [
        {"name": "film", "moves": "all gap probes", "bound": 1e-6, **shared},
        {"name": "contact", "moves": "one contact", "bound": 1e-4, **shared, "unit": "1"},
        {"name": "reading", "moves": "one reading", "bound": 1e-3, **shared},
    ]
    path.write_text(f"{path.read_text(encoding='utf-8')}\n{yaml.safe_dump({'causes': causes})}", encoding="utf-8")
    statement = compute_statement(parse_options([str(folder), "--angles=0"]))
    assert [each.key for each in statement.level_origins[:3]] == ["causes[2]"] * 3
    level = statement.reliability.protection_level[:3]
    assert f"leaves it within {micro_bound(max(level))} µm along each axis" in verdict(statement)
    assert micro_bound(max(level)) != micro_bound(min(level))


def test_the_scatter_of_an_arm_at_rest_gives_finite_degrees_of_freedom(tmp_path: Path) -> None:
    assert main(["five_axis", "--bag", str(BAG), "--angles=0,0,0,0,0", "--output", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "statement.json").read_text(encoding="utf-8"))
    about_z = content["uncertainty"]["about Z"]
    assert about_z["coverage_factor"] == pytest.approx(t.ppf(0.975, about_z["degrees_of_freedom"]), rel=1e-9)
    random = {part["source"]: part for part in content["components"] if part["kind"] == "random"}
    assert {part["origin"]["record"] for part in random.values()} == {"bag"}
    assert all(50 < part["degrees_of_freedom"] < 1000 for part in random.values())
    assert main(["five_axis", "--angles=0,0,0,0,0", "--output", str(tmp_path / "stated")]) == 0
    stated = json.loads((tmp_path / "stated" / "statement.json").read_text(encoding="utf-8"))["components"]
    noise = {part["source"]: np.trace(part["covariance"]) for part in stated if part["kind"] == "random"}
    ratios = [np.trace(part["covariance"]) / noise[name] for name, part in random.items()]
    assert 0.8 < np.mean(ratios) < 1.6  # the scenario has disturbances besides the stated noise
    (unusable,) = (each for each in content["reservations"] if "without a usable pose" in each)
    assert all(f" of {joint} (" in unusable for joint in load_arm_file("five_axis").calibrations)
    assert content["records"][-1]["role"] == "bag"


def test_an_arm_whose_beams_have_no_uncertainty_says_so(tmp_path: Path) -> None:
    arm = yaml.safe_load((ARMS / "five_axis" / "arm.yaml").read_text(encoding="utf-8"))
    del arm["beams"], arm["scenario"]
    arm["driver"] = {"source": "bag"}
    arm["urdf"] = str(ARMS / "five_axis" / arm["urdf"])
    for joint in arm["joints"].values():
        joint["calibration"] = str(ARMS / "five_axis" / joint["calibration"])
    path = tmp_path / "bare.yaml"
    path.write_text(yaml.safe_dump(arm), encoding="utf-8")
    assert main([str(path), "--angles=0,0,0,0,0", "--output", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "statement.json").read_text(encoding="utf-8"))
    sentence = "bare.yaml names no beams file: the beams are straight and exact, so U does not contain them."
    assert sentence in content["reservations"]
    counts = [each for each in content["reservations"] if each.startswith("No encoder confirms the count of")]
    assert len(counts) == 1


@pytest.mark.parametrize(("options", "code", "message"), REFUSALS)
def test_refusals(options: str, code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables = {
        "COLUMN": "elbow\n0\n",
        "CELL": "joint1\n0\n\nx\n",
        "UNDERSCORE": "joint1\n0_1\n",
        "WIDE": "joint1\n0,1\n",
        "DEGREES": "joint1\n30\n",
        "EMPTY": "joint1\n",
    }
    names = {"FIVE": str(BAG), "NONE": str(tmp_path / "NONE")}
    for name, text in tables.items():
        names[name] = str(tmp_path / f"{name}.csv")
        Path(names[name]).write_text(text, encoding="utf-8")
    given = [names.get(word, word) for word in shlex.split(options)]
    assert main([*given, "--output", str(tmp_path / "out")]) == code
    for name, text in names.items():
        message = message.replace(name, text)
    assert capsys.readouterr().err.startswith(message)
    assert not (tmp_path / "out").exists()

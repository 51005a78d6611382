# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``budget``: files, page and errors."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from posor.calibration.causes import FALSE_ALARM
from posor.calibration.designs import design
from posor_design.budget_command import OUTPUT_FILES, main
from posor_design.budget_report import CSV_COLUMNS
from posor_lab.harness.full_disk import full_disk_changes_nothing
from posor_lab.harness.report_page import ReportPage

POSE = "--pose=0.00001,0,0.00075,0.0005,-0.001,0.02"
POINT = "--point=-0.0254,0.0381"
SIX_AXIS = Path(__file__).resolve().parents[2] / "posor_bringup" / "arms" / "six_axis" / "arm.yaml"
QUANTITIES = ["x", "y", "gap", "alpha", "beta", "theta", "gap at (-25.4, 38.1) mm"]


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "triad.yaml"
    path.write_text(yaml.safe_dump(design("triad_diodes").model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def made(calibration: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("budget") / "deep" / "er"
    assert main([str(calibration), POSE, POINT, "--draws", "20000", "--output", str(folder)]) == 0
    return folder


@pytest.mark.usefixtures("few_draws")
def test_a_full_disk_keeps_all_former_files(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in OUTPUT_FILES:
        (tmp_path / name).write_text("former", encoding="utf-8")
    with full_disk_changes_nothing(tmp_path, 100_000):  # the page is larger
        assert main([str(calibration), POSE, "--draws", "1000", "--output", str(tmp_path)]) == 1
    sentence = f"{tmp_path / 'budget.html'}: cannot be written, File too large."
    assert capsys.readouterr().err.splitlines()[-1] == sentence


def test_all_files_agree(made: Path) -> None:
    assert sorted(path.name for path in made.iterdir()) == sorted(OUTPUT_FILES)
    content = json.loads((made / "budget.json").read_text(encoding="utf-8"))
    assert list(content["quantities"]) == QUANTITIES
    assert content["pose"]["theta"] == pytest.approx(0.02)
    assert content["pose"]["gap"] == pytest.approx(0.75e-3)
    with (made / "budget.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert len(rows) == len(content["contributions"]) * len(QUANTITIES)
    for name, found in content["quantities"].items():
        own = [row for row in rows if row["quantity"] == name]
        assert {row["unit"] for row in own} == {found["unit"]}
        total = np.linalg.norm([float(row["standard_uncertainty"]) for row in own])
        assert total == pytest.approx(found["root_sum_square"], rel=1e-6)
        assert np.hypot(found["random"], found["systematic"]) == pytest.approx(found["full_covariance"], rel=1e-9)
        assert sum(float(row["share_of_variance"]) for row in own) == pytest.approx(1.0, rel=1e-6)
        assert found["monte_carlo"]["standard_uncertainty"] == pytest.approx(found["full_covariance"], rel=0.025)
        low, high = found["monte_carlo"]["interval_95"]
        assert low < found["value"] < high
    covariance = np.array(content["covariance"])
    sigmas = [found["full_covariance"] for found in content["quantities"].values()]
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), sigmas)


def test_the_page_is_self_contained_and_complete(made: Path) -> None:
    page = (made / "budget.html").read_text(encoding="utf-8")
    reader = ReportPage(page)
    assert reader.problems == []
    assert len(reader.data) == len(QUANTITIES)
    content = json.loads((made / "budget.json").read_text(encoding="utf-8"))
    (rows,) = (rows for name, rows in reader.data.items() if name.startswith("alpha_"))
    largest = max(part["standard_uncertainty"]["alpha"] for part in content["contributions"])
    shown = max(float(row["standard uncertainty [µrad]"]) for row in rows)
    assert shown == pytest.approx(1e6 * largest, rel=1e-6)
    for text in (*QUANTITIES, "gap_2: tip", "Monte Carlo", "full covariance", "JCGM 101", "target plane: point"):
        assert text in page, text


@pytest.mark.long
def test_the_table_ends_with_totals_and_names_correlated_quantities(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = yaml.safe_load(calibration.read_text(encoding="utf-8"))
    tips = ["sensors[0].probes[1].tip[2]", "sensors[0].probes[2].tip[2]"]
    variance = float(np.square(content["sensors"][0]["probes"][1]["tip"]["sigma"]).max())
    joint = {"entries": tips, "rows": [[variance], [0.5 * variance, variance]]}
    record = {
        "procedure": "by_hand",
        "method": "by hand",
        "date": "2026-01-01T00:00:00Z",
        "recording": {"name": "none", "sha256": ""},
        "replaced": tips,
        "covariances": [joint],
    }
    correlated = tmp_path / "correlated.yaml"
    correlated.write_text(yaml.safe_dump({**content, "fits": [record]}), encoding="utf-8")
    assert main([str(correlated), "--draws", "20000", "--output", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert not [line for line in err.splitlines() if not line.startswith("draws: ")]  # progress on a slow host
    order = ["gap_2: tip", "all random", "all systematic", "root sum square", "full covariance", "Monte Carlo, 20000"]
    places = [out.index(text) for text in order]
    assert places == sorted(places)
    assert "µrad" in out
    note = "The calibration states correlations of 2 quantities, such as gap_2: tip. Each contribution is that of one"
    assert note in " ".join(out.split())
    assert note in (tmp_path / "budget.html").read_text(encoding="utf-8")
    content = json.loads((tmp_path / "budget.json").read_text(encoding="utf-8"))
    assert content["vary_together"] == ["gap_2: tip", "gap_3: tip"]
    assert "Taken as exact, no uncertainty is stated: target plane: point." in out


def test_a_triad_says_that_its_biases_are_not_detectable(made: Path) -> None:
    reliability = json.loads((made / "budget.json").read_text(encoding="utf-8"))["reliability"]
    assert (reliability["false_alarm"], reliability["missed_detection"]) == pytest.approx((FALSE_ALARM, 1e-2))
    gaps = [reading for reading in reliability["readings"] if reading["name"].startswith("gap ")]
    assert len(gaps) == 3
    for reading in gaps:
        assert reading["minimal_detectable_bias"] is None
        assert None in reading["undetected_shift"]
    page = (made / "budget.html").read_text(encoding="utf-8")
    assert page.count("not detectable") >= 3
    assert "Protection level of the endpoint" not in page


@pytest.mark.usefixtures("few_draws")
def test_an_arm_gets_the_protection_level_of_its_endpoint(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    angles = (0.1, 0.2, -0.3, 0.4, 0.5, -0.6)
    options = ["--arm", str(SIX_AXIS), "--angles=" + ",".join(map(str, angles)), "--output", str(tmp_path)]
    assert main([str(calibration), "--draws", "1000", *options]) == 0
    found = json.loads((tmp_path / "budget.json").read_text(encoding="utf-8"))["arm"]
    assert tuple(found["angles"].values()) == angles
    level = np.array(found["protection_level"])
    effects = [joint["endpoint_effects"] for joint in found["joints"].values()]
    shifts = np.array([effect for own in effects for effect in own.values()])
    bound = np.array(found["beam_temperature_bound"])
    assert np.all(bound[:3] > 1e-6)
    assert np.all(level > shifts.max(axis=0) + bound)
    out = capsys.readouterr().out
    assert "protection level" in out
    assert "temperature" in out
    assert all(": " in each for each in found["set_by"])
    assert "Protection level of the endpoint" in (tmp_path / "budget.html").read_text(encoding="utf-8")


REFUSALS = yaml.safe_load(Path(__file__).with_name("budget_refusals.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("options", "code", "sentence"), REFUSALS)
def test_wrong_options_are_refused(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: str, code: int, sentence: str
) -> None:
    given = options.replace("ARM", str(SIX_AXIS)).split()
    assert main([str(calibration), "--output", str(tmp_path / "none"), *given]) == code
    out, err = capsys.readouterr()
    assert err.startswith(sentence)
    assert err.count("\n") == 1
    assert not out
    assert not list(tmp_path.iterdir())


def test_an_arm_without_calibration_leads_to_the_statement(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--arm", str(SIX_AXIS)]) == 2
    sentence = "budget: no calibration file is given; the endpoint of an arm has 'posor statement ARM --angles=...'; "
    assert capsys.readouterr().err.startswith(sentence)


def test_a_missing_file_and_an_unwritable_folder_are_named(
    calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["none.yaml"]) == 1
    assert "calibration file none.yaml: cannot be read" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.delattr("posor_design.budget_command.monte_carlo")  # refused before anything is drawn
    assert main([str(calibration), "--output", str(tmp_path / "file" / "x")]) == 1
    assert capsys.readouterr().err == f"{tmp_path / 'file' / 'x'}: cannot be written, Not a directory.\n"

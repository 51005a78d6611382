# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""calibrate_demo from end to end: bags, calibration files, report, figures, verdict."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from posor.calibration.calibration_file import load_calibration
from posor_lab.campaign.calibrate_demo_command import main
from posor_lab.harness.program import installed
from posor_lab.harness.report_page import ReportPage

CAMPAIGNS = 4


@dataclass(frozen=True)
class DemoRun:
    folder: Path
    code: int
    out: str

    @property
    def figures(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.folder.with_name("calibration.json").read_text(encoding="utf-8"))
        return content


def run_demo(folder: Path, *options: str) -> DemoRun:
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        code = main([*options, "--output", str(folder / "calibration")])
    return DemoRun(folder / "calibration", code, output.getvalue())


@pytest.fixture(scope="module")
def diodes(tmp_path_factory: pytest.TempPathFactory) -> DemoRun:
    return run_demo(tmp_path_factory.mktemp("diodes"), "--posor", "triad_diodes", "--campaigns", str(CAMPAIGNS))


@pytest.mark.long
def test_bags_page_and_verdict(diodes: DemoRun) -> None:
    assert diodes.code == 0
    assert "triad_diodes: recording bags: 10 done in" in diodes.out
    assert f"triad_diodes: more campaigns: {CAMPAIGNS} done in" in diodes.out
    assert f"all parameters of {CAMPAIGNS} campaigns" in diodes.out
    assert diodes.out.rstrip().endswith("Everything holds.")
    assert (diodes.folder / "triad_diodes" / "bags" / "1_gaps" / "metadata.yaml").exists()
    text = (diodes.folder / "report.html").read_text(encoding="utf-8")
    reader = ReportPage(text)
    assert reader.problems == []
    assert len(reader.data["Estimate_less_truth_each_parameter.csv"]) == 105
    assert len(reader.data) == 4 + 9 + 6
    calibration = load_calibration(diodes.folder / "triad_diodes" / "9_bundle.yaml")
    for record in calibration.fits:
        assert record.recording.sha256 in text
        assert record.date in text
    assert "interferometer: 0.05 µm<" in text
    assert "autocollimator: 1000 µm, 1.5 µrad<" in text
    assert "measuring machine: 0.3 µm, 3 µrad<" in text


@pytest.mark.long
def test_figures_of_every_parameter(diodes: DemoRun) -> None:
    figures = diodes.figures["triad_diodes"]
    assert diodes.figures["holds"] is True
    calibration = load_calibration(diodes.folder / "triad_diodes" / "9_bundle.yaml")
    assert figures["content_hash"] == calibration.content_hash
    assert len(figures["parameters"]) == 105
    for number in figures["parameters"].values():
        assert set(number) == {"family", "unit", "truth", "estimate", "sigma", "within_95", "measured_by"}
        assert number["within_95"] is (abs(number["estimate"] - number["truth"]) < 1.96 * number["sigma"])
    tip = figures["parameters"]["sensors[0].probes[0].tip[0]"]
    assert tip["estimate"] == calibration.sensors[0].model_dump()["probes"][0]["tip"]["value"][0]
    measured = {name: number["measured_by"] for name, number in figures["parameters"].items()}
    for k in range(3):
        assert measured[f"sensors[0].probes[{k}].volts_to_gap[1]"] == "1_gaps"
        assert measured[f"sensors[0].probes[{k}].supply.sensitivity"] == "2_supply"
        assert measured[f"sensors[0].probes[{k}].supply.reference"] is None
        assert measured[f"sensors[0].probes[{k}].zero_shift"] == "8_drift"
    assert figures["steps"]["1_gaps"]["sha256"] == calibration.fits[0].recording.sha256
    many = figures["campaigns"]
    assert many["count"] == CAMPAIGNS
    assert not many["refused"]
    assert set(many["by_number"]) == set(figures["parameters"])
    assert many["within_95"]["value"] == pytest.approx(sum(many["by_number"].values()) / 105)
    assert set(many["fresh_root_mean_square"]) == set(figures["fresh_poses"]["root_mean_square"])


@pytest.mark.long
def test_the_other_posor_without_further_campaigns(tmp_path: Path) -> None:
    ring = run_demo(tmp_path, "--posor", "triad_bumpy_ring", "--campaigns", "0")
    assert ring.code == 0
    figures = ring.figures["triad_bumpy_ring"]
    assert figures["campaigns"] is None
    errors = figures["fresh_poses"]["root_mean_square"]
    for freedom, error in errors["errors"].items():
        assert error < 2.0 * errors["budget"][freedom]
        assert error < errors["errors_as_built"][freedom]
    assert not list(ring.folder.glob("triad_diodes*"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--posor", "tripod"], "argument --posor: invalid choice: 'tripod'"),
        (["--campaigns", "1"], "calibrate_demo: --campaigns 1; expected 0, or at least 4."),
        (["--campaigns", "-3"], "calibrate_demo: --campaigns -3; expected 0, or at least 4."),
        (["--campaigns", "many"], "argument --campaigns: invalid int value: 'many'"),
        (["--seed", "-1"], "calibrate_demo: --seed -1; expected 0 or more."),
        (["--campaings", "4"], "unrecognized arguments: --campaings 4"),
    ],
)
def test_invalid_options_are_refused(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_output_folder_that_is_a_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    assert main(["--output", str(tmp_path / "taken")]) == 1
    assert capsys.readouterr().err == f"{tmp_path / 'taken'}: cannot be written, File exists.\n"


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_the_run_with_one_line(tmp_path: Path, number: signal.Signals) -> None:
    command = [*installed("posor_lab", "calibrate_demo"), "--output", str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline().startswith("triad_diodes: recording bags: 10 done")
        program.send_signal(number)
        _, error = program.communicate(timeout=60)
    assert program.returncode == 130
    assert error == "calibrate_demo: interrupted.\n"

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""calibrate as its user runs it: a bag and a calibration file in, a calibration file out; list, diff and check."""

from __future__ import annotations

import json
import math
import re
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from posor.bags.calibration_recording import bag_sha256
from posor.calibration.calibration_file import Calibration, load_calibration
from posor.calibration.fit_record import FitRecord
from posor.calibration.parameter_covariance import is_part
from posor.certificates.dcc_check import check_dcc
from posor.ros_names import POSE_STAMPED, TRANSFORM_STAMPED
from posor_calibration.calibrate_command import main
from posor_calibration.calibration_comparison import compare_calibrations
from posor_calibration.calibration_update import find_quantity
from posor_calibration.outcome_report import MAX_LINES
from posor_calibration.outcome_tables import WIDTH
from posor_calibration.procedure_registry import PROCEDURES
from posor_lab.harness.calibration_bag import TYPES, entries, write_bag
from posor_lab.harness.case_tables import cases
from posor_lab.harness.certificates import CERTIFICATE, SCHEMA, needs_schema, numbers, quantities, read_dcc, texts
from posor_lab.harness.drawn_posor import ABOUT, ALONG, DrawnPosor
from posor_lab.harness.full_disk import full_disk_changes_nothing
from posor_lab.harness.program import installed

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "ros2_ws" / "src" / "posor_bringup" / "config"
KEYS = ("sensors[0].probes[*].zero_shift", "sensors[0].probes[*].volts_to_gap", "sensors[0].target_plane.tilt")
REFERENCE = ("--uncertainty", f"/reference={ALONG},{ABOUT}", "--instrument", "/reference=CMM 4")


class Bench:
    """A bag of a drawn POSOR, and the file that it is calibrated from."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.drawn = DrawnPosor("triad_diodes", 60, 7)
        self.bag = write_bag(folder / "bag", entries(self.drawn.recording()))
        self.file = folder / "design.yaml"
        content = self.drawn.calibration.model_dump(mode="json", exclude_none=True)
        text = yaml.safe_dump(content, sort_keys=False)
        self.file.write_text(f"# the designer's own file\n{text}", encoding="utf-8")

    def with_pose_stamped(self) -> Path:
        converted = []
        for topic, kind, time_ns, message in entries(self.drawn.recording()):
            if kind == TRANSFORM_STAMPED:
                place, turn = message.transform.translation, message.transform.rotation
                position = TYPES.new("geometry_msgs/msg/Point", x=place.x, y=place.y, z=place.z)
                pose = TYPES.new("geometry_msgs/msg/Pose", position=position, orientation=turn)
                stamped = TYPES.new(POSE_STAMPED, header=message.header, pose=pose)
                converted.append((topic, POSE_STAMPED, time_ns, stamped))
            else:
                converted.append((topic, kind, time_ns, message))
        return write_bag(self.folder / "pose_stamped", converted)

    def fit(self, output: Path, *options: str) -> Done:
        arguments = ("--calibration", str(self.file), "--output", str(output), "--parameters", *KEYS, *REFERENCE)
        return calibrate("bundle", str(self.bag), *arguments, *options)


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def calibrate(*arguments: str) -> Done:
    """Run the program's main function: a process for each would cost minutes."""
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        try:
            code = main(arguments)
        except SystemExit as end:  # --help
            code = int(end.code or 0)
    return Done(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("calibrate"))


@pytest.fixture(scope="module")
def fitted(bench: Bench) -> Path:
    output = bench.folder / "fitted.yaml"
    lab = bench.folder / "lab.yaml"
    lab.write_text(CERTIFICATE, encoding="utf-8")
    dcc = ("--dcc", str(bench.folder / "dcc.xml"), "--certificate", str(lab))
    done = bench.fit(output, "--loss", "linear", *dcc)
    assert (done.returncode, done.stderr.strip()) == (0, ""), done.stderr
    return output


def test_list_names_every_procedure() -> None:
    command = [*installed("posor_calibration", "calibrate"), "list"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert {"bundle", "gap_linearisation", "zero_drift"} <= PROCEDURES.keys()
    for name in PROCEDURES:
        assert re.search(rf"\b{name}\b", done.stdout), name


@pytest.mark.parametrize("name", [*PROCEDURES])
def test_help_lists_every_option_with_text_and_default(name: str) -> None:
    done = calibrate(name, "--help")
    assert done.returncode == 0
    text = " ".join(done.stdout.split())
    for field, declared in PROCEDURES[name].options.model_fields.items():
        assert f"--{field.replace('_', '-')}" in text
        assert declared.description, field
        assert " ".join(declared.description.split())[:30] in re.sub(r"- (?=\w)", "-", text), field


def test_a_fit_becomes_a_file_with_its_record(bench: Bench, fitted: Path) -> None:
    text = fitted.read_text(encoding="utf-8")
    assert text.startswith("# the designer's own file\n")
    calibration = load_calibration(fitted)
    [record] = calibration.fits
    assert (record.procedure, calibration.version) == ("bundle", 3)
    assert (record.recording.name, record.recording.sha256) == ("bag", bag_sha256(bench.bag))
    assert record.former == load_calibration(bench.file).content_hash
    assert record.options == {"parameters": " ".join(KEYS), "loss": "linear"}
    [instrument] = record.instruments
    assert (instrument.topic, instrument.name) == ("/reference", "CMM 4")
    assert instrument.sigmas == pytest.approx([ALONG] * 3 + [ABOUT] * 3)
    [covariance] = record.covariances
    assert len(covariance.entries) == len(covariance.matrix) > 10
    # The residuals show what was not fitted; the result's uncertainty has it.
    assert record.residuals["bundle"].spread > 1.5
    assert any("were not fitted" in warning for warning in record.warnings)
    assert str(bench.folder) not in text


def test_the_certificate_holds_the_numbers_of_the_calibration_file(bench: Bench, fitted: Path) -> None:
    document, calibration = read_dcc(bench.folder / "dcc.xml"), load_calibration(fitted)
    found = quantities(document)
    [record] = calibration.fits
    for key in record.replaced:
        stated = find_quantity(calibration, key)
        for index in np.ndindex(stated.array.shape):
            name = key + "".join(f"[{i}]" for i in index)
            value, sigma = float(stated.array[index]), float(stated.sigmas[index])
            own = found.pop(name)
            if sigma > 0.0:
                assert numbers(own) == pytest.approx([value, 2.0 * sigma, 2.0, 0.9545], rel=1e-9)
            else:
                assert texts(own, "si:value") == [repr(value)]
    assert not found
    assert calibration.content_hash in texts(document, "dcc:value")
    assert {r"\metre", r"\metre\volt\tothe{-1}", r"\radian", r"\volt"} <= set(texts(document, "si:unit"))


def test_the_certificate_contains_the_scale_of_the_reference(bench: Bench, fitted: Path) -> None:
    scaled, dcc = bench.folder / "scaled.yaml", bench.folder / "scaled.xml"
    options = ("--dcc", str(dcc), "--certificate", str(bench.folder / "lab.yaml"), "--length-scale", "scale=1e-3")
    assert bench.fit(scaled, "--loss", "linear", *options).returncode == 0
    found, without = quantities(read_dcc(dcc)), quantities(read_dcc(fitted.with_name("dcc.xml")))
    keys = load_calibration(scaled).shared["scale"].relative
    scaled_numbers = 0
    for name, own in without.items():
        if not texts(own, "si:uncertainty"):
            continue
        (value, expanded, *_), (_, total, *_) = numbers(own), numbers(found[name])
        is_scaled = any(is_part(name, key) for key in keys)
        scaled_numbers += is_scaled
        assert total == pytest.approx(math.hypot(expanded, 2e-3 * value if is_scaled else 0.0), rel=1e-6)
    assert scaled_numbers > 5


@needs_schema
def test_the_certificate_is_valid(bench: Bench, fitted: Path) -> None:
    assert fitted.exists()
    check_dcc(bench.folder / "dcc.xml", SCHEMA)


def test_nothing_is_overwritten_without_force_and_the_old_file_is_kept(bench: Bench, fitted: Path) -> None:
    before = fitted.read_text(encoding="utf-8")
    done = bench.fit(fitted)
    assert done.returncode == 1
    assert done.stderr == f"calibration file {fitted}: exists already; expected another name, or --force.\n"
    assert fitted.read_text(encoding="utf-8") == before
    copy = bench.folder / "copy.yaml"
    copy.write_text(before, encoding="utf-8")
    for page in (copy.with_suffix(".html"), copy.with_suffix(".json")):
        page.write_text("former", encoding="utf-8")
    with full_disk_changes_nothing(bench.folder, 18_000):  # the figures are larger
        done = bench.fit(copy, "--force")
    assert (done.returncode, done.stderr) == (1, f"{copy.with_suffix('.json')}: cannot be written, File too large.\n")
    done = bench.fit(copy, "--force", "--loss", "huber")
    assert done.returncode == 0
    assert f"{copy}.1\n" in done.stdout
    assert "copy.json; replaced: copy.html and copy.json\n" in done.stdout
    assert (bench.folder / "copy.yaml.1").read_text(encoding="utf-8") == before
    assert load_calibration(copy).fits[0].options["loss"] == "huber"


def test_without_an_output_the_result_is_only_printed(bench: Bench) -> None:
    there = set(bench.folder.iterdir())
    arguments = ("bundle", str(bench.bag), "--calibration", str(bench.file), "--parameters", KEYS[0])
    done = calibrate(*arguments)
    assert done.returncode == 0
    assert "Note: The reference is taken as exact" in done.stdout
    assert done.stdout.endswith("No --output: nothing is written.\n")
    whole = calibrate(*arguments, "--all")
    assert whole.stdout.endswith(done.stdout)
    assert len(re.findall(r"│ sensors\[0\]\.probes\[0\]\.zero_shift", whole.stdout)) >= 2
    assert set(bench.folder.iterdir()) == there


def test_the_verdict_is_short_and_the_rest_is_in_page_and_json(bench: Bench) -> None:
    output = bench.folder / "verdict.yaml"
    done = bench.fit(output, "--loss", "linear")
    lines = done.stdout.splitlines()
    assert len(lines) <= MAX_LINES, done.stdout
    assert max(map(len, lines[:-3])) <= WIDTH  # the paths of the files may be longer
    assert lines[0] == "bundle: usable with care: the residuals exceed the stated uncertainties."
    assert lines[1].startswith("Residuals: ")
    for subject in ("Worst determined: ", "Not determined ", "Largest change: ", "Repeatability: not measured"):
        assert sum(line.startswith(subject) for line in lines) == 1, subject
    page, figures = output.with_suffix(".html"), json.loads(output.with_suffix(".json").read_text(encoding="utf-8"))
    [record] = load_calibration(output).fits
    assert figures["verdict"][0] == lines[0]
    assert figures["notes"] == record.warnings
    assert figures["fits"]["bundle"]["spread"] == pytest.approx(record.residuals["bundle"].spread)
    assert len(figures["fits"]["bundle"]["values"]) == len(record.covariances[0].entries)
    text = page.read_text(encoding="utf-8")
    for table in figures["tables"]:
        assert f"<h2>{table['title']}</h2>" in text
    output.unlink()
    done = bench.fit(output)
    assert (done.returncode, done.stderr) == (1, f"{page}: exists already; expected another --output, or --force.\n")
    assert not output.exists()


def test_the_real_recording_of_1985_is_calibrated_into_its_session_and_its_curves_have_charts(tmp_path: Path) -> None:
    output, source = tmp_path / "rig.yaml", CONFIG / "slocum1985_section84.yaml"
    options = ("--lever", "0.798322", "--session", "ymo", "--first-sigma", "0", "--output", str(output))
    done = calibrate("zero_drift", str(ROOT / "bags" / "ymo"), "--calibration", str(source), *options)
    assert done.returncode == 0, done.stderr
    before, after = load_calibration(source), load_calibration(output)
    assert after.fits[0].replaced == ["sessions.ymo.zero_shifts"]
    compared = compare_calibrations(before, after)
    assert {d.name for d in compared.differences} == {f"sessions.ymo.zero_shifts[{k}]" for k in range(3)}
    assert compared.others == ()
    charts = json.loads(output.with_suffix(".json").read_text(encoding="utf-8"))["figures"]
    page = output.with_suffix(".html").read_text(encoding="utf-8")
    assert charts
    for chart in charts:
        assert chart["title"] in page
        assert all(len(series["x"]) == len(series["y"]) > 10 for series in chart["series"].values())


def test_diff_shows_what_changed_in_sigmas(bench: Bench, fitted: Path) -> None:
    done = calibrate("diff", str(bench.file), str(fitted), "--all")
    assert done.returncode == 0
    assert "sigmas of the first, from which the second was fitted" in done.stdout
    assert "sensors[0].probes[2].volts_to_gap[0]" in "".join(done.stdout.split())
    assert re.search(r"\d+ of \d+ numbers differ", done.stdout)
    same = calibrate("diff", str(fitted), str(fitted))
    assert same.stdout.strip().startswith("0 of ")


def test_check_finds_drift(bench: Bench) -> None:
    done = calibrate("check", str(bench.file), str(bench.bag), *REFERENCE)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "explains" in done.stdout
    assert "no parameter has drifted" in " ".join(done.stdout.split())
    bumped = bench.folder / "bumped.yaml"
    content = yaml.safe_load(bench.file.read_text(encoding="utf-8"))
    content["sensors"][0]["probes"][1]["zero_shift"]["value"] += 0.1
    bumped.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    done = calibrate("check", str(bumped), str(bench.bag), *REFERENCE)
    assert done.returncode == 3, done.stdout + done.stderr
    text = " ".join(done.stdout.split())
    assert "does not explain" in text
    assert "sensors[0].probes[1].zero_shift" in text


def test_check_takes_the_uncertainty_of_the_record_or_asks_for_it(bench: Bench, fitted: Path) -> None:
    done = calibrate("check", str(bench.file), str(bench.bag))
    sentence = "calibrate check: the uncertainty of /reference is unknown: no fit of 'triad_diodes' records it; "
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith(f"{sentence}expected the option --uncertainty /reference=M,RAD.\n")
    recorded = calibrate("check", str(fitted), str(bench.bag))
    assert recorded.stdout == calibrate("check", str(fitted), str(bench.bag), *REFERENCE).stdout
    assert len(recorded.stdout.splitlines()) <= MAX_LINES
    other = calibrate("check", str(fitted), str(bench.bag), "--uncertainty", "/reference=1e-5,1e-4")
    assert "Residuals against" in other.stdout
    assert other.stdout != recorded.stdout


def test_a_reference_may_be_a_named_pose_stamped(bench: Bench) -> None:
    bag = bench.with_pose_stamped()
    same = calibrate("check", str(bench.file), str(bag), *REFERENCE)
    expected = calibrate("check", str(bench.file), str(bench.bag), *REFERENCE)
    assert same.stdout.split() == expected.stdout.replace(str(bench.bag), str(bag)).split()
    unnamed = calibrate("bundle", str(bag), "--calibration", str(bench.file), "--parameters", KEYS[0], "--all")
    assert "poses unknown" in unnamed.stdout


def test_diff_leaves_out_numbers_without_an_uncertainty(bench: Bench) -> None:
    exact = bench.folder / "exact.yaml"
    content = yaml.safe_load(bench.file.read_text(encoding="utf-8"))
    noise, shift = (content["sensors"][0]["probes"][1][key] for key in ("noise", "zero_shift"))
    assert noise.get("sigma", 0.0) == 0.0
    noise["value"] *= 2.0
    shift["value"] += 1e-3
    exact.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    done = calibrate("diff", str(bench.file), str(exact))
    assert "probes[1].noise" not in done.stdout
    assert "probes[1].zero_shift" in done.stdout
    assert "2 of " in done.stdout
    assert "Left out: 1 that have no uncertainty" in done.stdout
    assert "probes[1].noise" in calibrate("diff", str(bench.file), str(exact), "--all").stdout


@pytest.mark.parametrize(**cases(__file__, "calibrate_options.yaml"))
def test_a_wrong_option_is_one_sentence(bench: Bench, options: list[str], code: int, sentence: str) -> None:
    done = calibrate("bundle", str(bench.bag), "--calibration", str(bench.file), *options)
    assert done.returncode == code
    assert done.stderr.strip().split("\n")[-1].startswith(sentence), done.stderr
    assert "Traceback" not in done.stderr


def test_options_that_are_missing_are_named(bench: Bench) -> None:
    done = calibrate("beam_transform", str(bench.bag), "--calibration", str(bench.file), *REFERENCE)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "option --second, option --reference, option --beam: are missing.\n"


def test_a_reference_that_is_a_number_is_no_topic(bench: Bench) -> None:
    options = [str(bench.bag), "--calibration", str(bench.file), "--reference", "293.15"]
    done = calibrate("temperature_sensitivity", *options)
    assert done.returncode == 1
    assert done.stderr.startswith(f"{bench.bag}: the temperature of the plate was not measured; expected ")


def test_a_reference_that_is_not_in_the_bag_is_named(bench: Bench, tmp_path: Path) -> None:
    output = tmp_path / "never.yaml"
    options = ("--calibration", str(bench.file), "--reference", "/laser", "--output", str(output))
    done = calibrate("bundle", str(bench.bag), *options)
    assert done.returncode == 1
    assert "/laser" in done.stderr
    assert not output.exists()


def test_the_fits_that_the_documentation_shows_are_fits() -> None:
    text = (ROOT / "docs" / "reference" / "calibration_file.md").read_text(encoding="utf-8")
    content = yaml.safe_load("".join(re.findall(r"^```yaml\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)))
    [shown] = content["fits"]
    record = FitRecord.model_validate(shown)
    assert set(shown) == set(FitRecord.model_fields)
    assert record.covariances[0].matrix.shape == (3, 3)
    for key in Calibration.model_fields:
        assert f"`{key}`" in text


@pytest.mark.parametrize("name", ["rig.json", "rig.html"])
def test_a_calibration_file_is_not_named_like_a_report(bench: Bench, name: str) -> None:
    done = bench.fit(bench.folder / name)
    assert done.returncode == 1
    assert done.stderr.startswith(f"{bench.folder / name}: is the name of a report; expected a name ")
    assert not (bench.folder / name).exists()

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows of the table of wiring faults, arms without a fault, and 'posor commission' with recordings as real bags."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from posor.chain.arm_file import chain_parameters
from posor.chain.commissioning_record import load_record
from posor.chain.identity import calibration_id
from posor.errors import BagError, SeveralErrors
from posor.node_parameters import ChainParameters
from posor.parameter_model import validate_parameters
from posor_bringup.arms import load_checked_arm
from posor_bringup.commission_command import NOT_PASSED, main
from posor_calibration.commissioning.commissioning_recording import CommissioningTopics, load_commissioning
from posor_estimator.endpoint_verdict import SOUND as SOUND_VERDICT
from posor_estimator.identity_check import IdentityCheck
from posor_lab.commissioning.commissioning_command import GROUPS, TABLE, FaultRow, judge_fault, report_with
from posor_lab.commissioning.simulated_commissioning import REFERENCE, SimulatedCommissioning, WiringFault
from posor_lab.harness.case_tables import refusal

ARMS = ("five_axis", "six_axis")
SOUND = WiringFault("none", ())
SHOWN = [row for n, row in enumerate(TABLE) if row.group == "files" or n % 8 == 0]
"""A part of the table; ``make commissioning`` runs all rows."""


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> dict[str, SimulatedCommissioning]:
    folder = tmp_path_factory.mktemp("arms")
    return {name: SimulatedCommissioning(name, folder / name, seed=11) for name in ARMS}


@pytest.fixture(scope="module")
def bag(arms: dict[str, SimulatedCommissioning], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of the five-axis arm without a fault."""
    sound = arms["five_axis"]
    return sound.write_bag(sound.recording, tmp_path_factory.mktemp("recorded") / "bag")


def commission(sound: SimulatedCommissioning, bag: Path, output: Path, *options: str) -> int:
    reference = ("--reference-topic", REFERENCE, "--serial", sound.arm.serial)
    arguments = [str(sound.arm.path), "--bag", str(bag), "--output", str(output), *reference, *options]
    return main(["commission", *arguments])


def test_the_table_has_the_faults_that_it_must_have() -> None:
    counts = {(arm, group): sum((r.arm, r.group) == (arm, group) for r in TABLE) for arm in ARMS for group in GROUPS}
    assert counts == {(arm, group): n for arm in ARMS for group, n in zip(GROUPS, (24, 6, 7, 2), strict=True)}
    assert len({(row.arm, row.fault.name) for row in TABLE}) == len(TABLE)


@pytest.mark.parametrize("row", SHOWN, ids=lambda row: f"{row.arm} {row.fault.name}"[:60])
def test_a_fault_is_found_by_a_check_of_its_kind(
    row: FaultRow, arms: dict[str, SimulatedCommissioning], tmp_path: Path
) -> None:
    result = judge_fault(arms[row.arm], row, tmp_path / "files")
    assert result.holds, result.kinds


@pytest.mark.parametrize("arm", ARMS)
def test_a_sound_arm_passes_and_says_what_was_not_checked(
    arm: str, arms: dict[str, SimulatedCommissioning], tmp_path: Path
) -> None:
    report = report_with(arms[arm], SOUND, tmp_path / "files")
    assert not report.failed
    record = report.record()
    assert record is not None
    assert set(record.limits) == set(arms[arm].calibrations)
    assert record.limits["elbow"]["theta"][1] - record.limits["elbow"]["theta"][0] > 0.5
    page = report.to_page()
    assert "no step changes either" in page
    assert "a gain wrong by less than" in page
    assert "growth of all gaps" in page


def test_the_program_writes_page_numbers_and_a_record_from_a_bag(
    arms: dict[str, SimulatedCommissioning], bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sound, output = arms["five_axis"], tmp_path / "out"
    record = sound.arm.path.parent / "commissioning.json"
    assert commission(sound, bag, output) == 0
    first = load_record(record)
    assert f"identity {first.identity}" in capsys.readouterr().out
    content = json.loads((output / "report.json").read_text(encoding="utf-8"))
    assert content["passed"]
    assert len(content["recording_sha256"]) == 64
    assert content["checks"] == [check.model_dump() for check in first.checks]
    assert "<h1" in (output / "report.html").read_text(encoding="utf-8")
    parameters = chain_parameters(sound.arm) | {"commissioning": str(record)}
    check = IdentityCheck(validate_parameters(ChainParameters, parameters, node="chain_node"), list(sound.calibrations))
    check.update([calibration_id(each) for each in sound.calibrations.values()])
    assert (check.sha256, check.refuses, check.verdict) == (first.identity, False, SOUND_VERDICT)
    assert commission(sound, bag, output) == 0  # repeated: the record stays
    assert "--force replaces it" in capsys.readouterr().out
    assert load_record(record) == first
    assert commission(sound, bag, output, "--force") == 0
    assert "the old one is" in capsys.readouterr().out
    second = load_record(record)
    assert second.files == first.files
    assert "the same, compared with those of" in second.checks[1].found
    record.unlink()
    assert commission(sound, bag, output, "--joint", "elbow") == 0  # a part of the arm has no record
    assert not record.exists()


def test_the_program_fails_an_arm_with_exchanged_plugs_and_writes_no_record(
    arms: dict[str, SimulatedCommissioning], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = arms["six_axis"]
    fault = WiringFault("plugs", (), exchange=(("elbow gap_1", "elbow gap_4"), ("elbow gap_2", "elbow gap_3")))
    bag = sound.write_bag(sound.recording_with(fault), tmp_path / "bag")
    assert commission(sound, bag, tmp_path / "out", "--joint", "elbow") == NOT_PASSED
    assert "FAILED  elbow: lift gap_1: gap_4 reacts instead of gap_1: their plugs are exchanged\n" in (
        capsys.readouterr().out
    )
    assert not (sound.arm.path.parent / "commissioning.json").exists()


def test_a_record_that_was_changed_is_refused_before_anything_is_started(
    arms: dict[str, SimulatedCommissioning], tmp_path: Path
) -> None:
    path = shutil.copytree(arms["five_axis"].arm.path.parent, tmp_path / "arm") / "arm.yaml"
    path.write_text(path.read_text(encoding="utf-8") + "commissioning: record.json\n", encoding="utf-8")
    load_checked_arm(str(path))  # before the first commissioning there is no record
    (path.parent / "record.json").write_text("{version: 1}", encoding="utf-8")
    with pytest.raises(SeveralErrors) as caught:
        load_checked_arm(str(path))
    assert all(error.where.startswith(str(path.parent / "record.json")) for error in caught.value.parts)


def test_positions_of_several_joints_need_the_name_of_one(bag: Path) -> None:
    topics = CommissioningTopics(
        {"elbow": "/five_axis/elbow/raw"}, {"elbow": ("/five_axis/encoders", "")}, "/five_axis/commissioning/step"
    )
    error = refusal(BagError, load_commissioning, bag, topics)
    assert error.where == f"{bag}, topic /five_axis/encoders"
    assert (error.what, error.expected) == ("5 positions", "one, or the parameter 'encoder.joint'")


def test_a_recording_without_steps_is_refused(bag: Path) -> None:
    topics = CommissioningTopics({"elbow": "/five_axis/elbow/raw"}, {}, "/five_axis/other")
    assert "there is no topic /five_axis/other" in refusal(BagError, load_commissioning, bag, topics).what


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--lift", "0"], "argument --lift: '0' is not "),
        (["--postures", "4"], "--postures 4; expected --reference-topic too."),
        (["--rest-time", "-1"], "argument --rest-time: '-1' is not "),
    ],
)
def test_wrong_options_are_refused(options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commission", "six_axis", *options]) == 2
    assert sentence in capsys.readouterr().err

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The identity of an arm and its commissioning record: what they depend on, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from posor.calibration.designs import design
from posor.chain.arm_file import chain_parameters, load_arm_file
from posor.chain.commissioning_record import CheckRecord, CommissionedFiles, CommissioningContent, load_record
from posor.chain.identity import ArmIdentity, calibration_id, file_sha256
from posor.errors import CalibrationError
from posor_lab.harness.case_tables import refusal

ARM = ArmIdentity({"shoulder": "0" * 16, "elbow": "1" * 16}, "a" * 64, "", "")
CONTENT = CommissioningContent(
    arm="two",
    serial="7",
    date="2026-01-01",
    software="posor",
    files=CommissionedFiles(calibrations=dict(ARM.calibrations), urdf=ARM.urdf, beams=ARM.beams),
    checks=(CheckRecord(check="elbow: lift gap_1", found="reads 1.0", verdict="passed", blind="a gain"),),
    limits={"elbow": {"theta": (-0.5, 1e-17)}},
)


@pytest.fixture
def record(tmp_path: Path) -> Path:
    path = tmp_path / "commissioning.json"
    path.write_text(json.dumps(CONTENT.record().model_dump(mode="json")), encoding="utf-8")
    return path


def test_the_identity_depends_on_every_part() -> None:
    others = [
        replace(ARM, urdf="b" * 64),
        replace(ARM, beams="a" * 64),
        replace(ARM, record="a" * 64),
        ARM.with_calibrations({"shoulder": 1, "elbow": 0x1111111111111111}, ""),
        replace(ARM, calibrations={"elbow": "0" * 16, "shoulder": "1" * 16}),
    ]
    assert len({each.sha256 for each in (ARM, *others)}) == 6
    assert (
        replace(ARM, calibrations={joint: ARM.calibrations[joint] for joint in ("elbow", "shoulder")}).sha256
        == ARM.sha256
    )
    assert [list(each.differences(ARM)) for each in others] == [
        ["URDF"],
        ["beams file"],
        [],
        ["shoulder"],
        ["elbow", "shoulder"],
    ]


def test_the_id_of_a_calibration_follows_from_its_content_in_force() -> None:
    calibration = design("triad_diodes")
    number = calibration_id(calibration)
    assert f"{number:016x}" == calibration.content_hash[:16]
    assert calibration_id(calibration.model_copy(update={"name": "another"})) != number


def test_a_record_is_read_as_it_was_written(record: Path) -> None:
    read = load_record(record)
    assert read == CONTENT.record()
    assert read.parts() == CONTENT.parts()
    assert read.identity == replace(ARM, record=read.parts().record).sha256


def test_a_record_that_was_changed_is_refused(record: Path) -> None:
    record.write_text(record.read_text(encoding="utf-8").replace("reads 1.0", "reads 1.1"), encoding="utf-8")
    assert str(refusal(CalibrationError, load_record, record)) == (
        f"{record}, line 1, key identity: identity does not follow from the content, so the record was changed; "
        "expected the file as 'posor commission' wrote it."
    )


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"files": {"calibrations": {"elbow": "1"}, "urdf": "", "beams": ""}}, "files.calibrations.elbow"),
        ({"files": {"calibrations": {}, "urdf": "a", "beams": ""}}, "files.urdf"),
        ({"limits": {"elbow": {"theta": [1.0]}}}, "limits.elbow.theta"),
        ({"format": "posor_arm"}, "format"),
    ],
)
def test_invalid_content_is_refused_with_its_key(record: Path, change: dict[str, object], key: str) -> None:
    content = json.loads(record.read_text(encoding="utf-8")) | change
    record.write_text(json.dumps(content), encoding="utf-8")
    assert refusal(CalibrationError, load_record, record).where.endswith(f"key {key}")


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    assert file_sha256(None) == ""
    error = refusal(CalibrationError, file_sha256, tmp_path / "arm.urdf")
    assert error.where == str(tmp_path / "arm.urdf")


def test_an_arm_file_names_its_record_and_serial_number(tmp_path: Path) -> None:
    source = Path(__file__).with_name("two_joints") / "arm.yaml"
    path = tmp_path / "arm.yaml"
    text = source.read_text(encoding="utf-8")
    path.write_text(f"{text}serial: '0012'\ncommissioning: commissioning.json\n", encoding="utf-8")
    arm = load_arm_file(path)
    assert (arm.serial, arm.commissioning) == ("0012", tmp_path / "commissioning.json")
    assert chain_parameters(arm)["commissioning"] == str(arm.commissioning)
    assert (load_arm_file(source).serial, load_arm_file(source).commissioning) == ("", None)

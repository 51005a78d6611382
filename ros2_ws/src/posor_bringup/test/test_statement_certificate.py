# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor statement --dcc: the certificate holds the numbers of statement.json, read with another XML library."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from posor.certificates.dcc_command import main as dcc
from posor_bringup.statement_command import main
from posor_lab.harness.certificates import CERTIFICATE, SCHEMA, needs_schema, numbers, quantities, read_dcc, texts

UNITS = {"m": r"\metre", "rad": r"\radian"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dcc")
    (folder / "lab.yaml").write_text(CERTIFICATE, encoding="utf-8")
    options = ["--certificate", str(folder / "lab.yaml"), "--dcc", str(folder / "dcc.xml"), "--output", str(folder)]
    assert main(["five_axis", "--angles=0.4,-0.6,0.9,0.3,-0.5", *options]) == 0
    return folder


def test_results_conditions_and_identity_are_those_of_the_statement(folder: Path) -> None:
    document, stated = read_dcc(folder / "dcc.xml"), json.loads((folder / "statement.json").read_text(encoding="utf-8"))
    found = quantities(document)
    for n, (axis, of_axis) in enumerate(stated["uncertainty"].items()):
        name = f"{axis} of the endpoint in base" if n < 3 else f"deviation of the orientation {axis} of base"
        entry, level = found[name], found[f"protection level, {axis}"]
        value = stated["pose"]["position"][n] if n < 3 else 0.0
        assert numbers(entry) == [value, of_axis["expanded"], of_axis["coverage_factor"], 0.95]
        assert texts(entry, "si:unit") == [UNITS[of_axis["unit"]]]
        if of_axis["protection_level"] is None:
            assert texts(level, "dcc:content")[1:] == ["without bound"]
        else:
            assert float(texts(level, "si:value")[0]) == of_axis["protection_level"]
            assert texts(level, "si:unit") == [UNITS[of_axis["unit"]]]
    quaternion = [float(texts(found[f"quaternion {name}"], "si:value")[0]) for name in "xyzw"]
    assert quaternion == stated["pose"]["quaternion"]
    assert math.hypot(*quaternion) == pytest.approx(1.0)
    for joint, angle in stated["pose"]["angles"].items():
        assert float(texts(found[f"angle of {joint}"], "si:value")[0]) == angle
    content = texts(document, "dcc:content")
    for sentence in (*stated["sentences"][1:], *stated["reservations"]):
        assert sentence in content
    for name, condition in stated["conditions"].items():
        assert name == "joint angles" or {name, condition["value"]} <= set(content)
    values = texts(document, "dcc:value")
    assert {stated["arm"]["identity"], *(each["sha256"] for each in stated["records"])} <= set(values)
    assert texts(document, "dcc:release") == [stated["software"].split()[1]] * 2


def test_laboratory_persons_and_customer_are_those_of_the_certificate_file(folder: Path) -> None:
    document = read_dcc(folder / "dcc.xml")
    content = [*texts(document, "dcc:content"), *texts(document, "dcc:city"), *texts(document, "dcc:uniqueIdentifier")]
    stated = re.findall(r"(?:name|city|identifier): ([^,\n]+)", CERTIFICATE)
    assert len(stated) == 6
    assert set(stated) <= set(content)
    assert texts(document, "dcc:endPerformanceDate") == ["2026-11-25"]


@needs_schema
def test_the_certificate_of_a_statement_is_valid(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert dcc(["check", str(folder / "dcc.xml"), "--schema", str(SCHEMA)]) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--dcc", "NEW"], "statement: --dcc without --certificate; expected both."),
        (["--certificate", "LAB"], "statement: --certificate without --dcc; expected both."),
        (["--dcc", "OLD", "--certificate", "LAB"], "OLD: exists already; expected a new file for the certificate."),
    ],
)
def test_options_are_refused_before_the_statement(
    options: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = {"LAB": str(folder / "lab.yaml"), "OLD": str(folder / "dcc.xml"), "NEW": str(folder / "new.xml")}
    given = [paths.get(word, word) for word in options]
    assert main(["five_axis", "--angles=0,0,0,0,0", "--output", str(folder / "none"), *given]) != 0
    assert capsys.readouterr().err == message.replace("OLD", paths["OLD"]) + "\n"
    assert not (folder / "none").exists()

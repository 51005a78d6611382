# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Certificates as they are written are valid; each wrong field is one sentence that names it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml
from posor.certificates.certificate_file import load_certificate_file
from posor.certificates.dcc_check import check_dcc
from posor.certificates.dcc_command import main
from posor.certificates.dcc_document import Block, Certificate, HashedFile, Quantity, dcc_xml
from posor.certificates.dsi_units import is_dsi, to_dsi
from posor.errors import CalibrationError, CertificateError, OutputError, ParameterError
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.certificates import CERTIFICATE, SCHEMA, needs_schema

MISTAKES = yaml.safe_load(Path(__file__).with_name("dcc_mistakes.yaml").read_text(encoding="utf-8"))
XSD = '<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" targetNamespace="{}" version="3.2.1">\n{}</xs:schema>'
LENGTH = Quantity("length", 1.5e-6, "m", 2e-7, 2.0, 0.9545)


def certificate(*quantities: Quantity, sentences: tuple[str, ...] = ()) -> Certificate:
    return Certificate(
        title="Title",
        item="item",
        identifications={"serial number": "", "identity": "ab12"},
        software=("posor", "0.1"),
        method="method",
        norms=("JCGM 100:2008",),
        files=[HashedFile("bag", "bag.mcap", "0" * 64)],
        conditions=[Block("temperature", (), ("20 °C & still",))],
        results=[Block("result", quantities, sentences)],
        declarations={"notes": (), "meaning": ("a < b",)},
    )


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    path = tmp_path / "lab.yaml"
    path.write_text(CERTIFICATE, encoding="utf-8")
    return path


@pytest.fixture
def dcc(tmp_path: Path, lab: Path) -> Path:
    path = tmp_path / "dcc.xml"
    path.write_bytes(dcc_xml(certificate(LENGTH), load_certificate_file(lab)))
    return path


@needs_schema
@pytest.mark.parametrize(
    ("quantities", "sentences"),
    [
        ([LENGTH, Quantity("slope", -1e-320, "m/V")], ()),
        ([Quantity("level", float("inf"), "rad"), Quantity("x", 1.0, "1", float("inf"), 2.0, 0.95)], ()),
        ([], ("control \x01, half \ud800, end \uffff", "  ")),
    ],
)
def test_certificates_are_valid(quantities: list[Quantity], sentences: tuple[str, ...], dcc: Path, lab: Path) -> None:
    dcc.write_bytes(dcc_xml(certificate(*quantities, sentences=sentences), load_certificate_file(lab)))
    assert main(["check", str(dcc), "--schema", str(SCHEMA)]) == 0


@needs_schema
def test_a_relative_folder_may_hold_other_schemas(dcc: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = dcc.parent / "xsd"
    folder.mkdir()
    for path in SCHEMA.glob("*.xsd"):
        (folder / path.name).write_bytes(path.read_bytes())
    text = f"<!DOCTYPE xs:schema [<!ENTITY a 'b'>]>\n{XSD.format('http://www.w3.org/2000/09/xmldsig#', '')}"
    (folder / "xmldsig-core-schema.xsd").write_text(text, encoding="utf-8")
    monkeypatch.chdir(dcc.parent)
    assert main(["check", dcc.name, "--schema", "xsd"]) == 0


@needs_schema
@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_each_wrong_field_is_one_sentence(old: str, new: str, message: str, dcc: Path) -> None:
    text = dcc.read_text(encoding="utf-8")
    assert old in text
    dcc.write_text(text.replace(old, new, 1), encoding="utf-8")
    line = text[: text.index(old)].count("\n") + 1
    sentence = str(refusal(CertificateError, check_dcc, dcc, SCHEMA))
    assert sentence == message.replace("FILE", f"{dcc}, line").replace("SCHEMA", str(SCHEMA)).replace("LINE", str(line))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<a><b></a>", ", line 1: is not XML: mismatched tag, column 9; expected a Digital Calibration Certificate"),
        (b"", ", line 1: is not XML: no element found"),
        (b"%PDF-1.7", ", line 1: is not XML: unclosed token, column 1"),
        (b"<!DOCTYPE a [<!ENTITY b 'c'>]>\n<a/>", ", line 1: has a document type definition; expected"),
        (
            b"<?xml version='1.0' encoding='klingon'?><a/>",
            ": is not XML: unknown encoding: klingon; expected a Digital",
        ),
        (b"<a>" * 101, ", line 1: has elements nested deeper than 100; expected a Digital"),
        (b"<digitalCalibrationCertificate/>", ", line 1, digitalCalibrationCertificate: is the root, digital"),
        (None, ": cannot be read: No such file or directory; expected a Digital Calibration Certificate (XML)."),
    ],
)
def test_files_that_are_no_certificates(content: bytes | None, message: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "a.xml").write_bytes(content)
    error = refusal(CertificateError, check_dcc, tmp_path / "a.xml", tmp_path)
    assert str(error).startswith(f"{tmp_path / 'a.xml'}{message}")


IMPORT = '<xs:import namespace="https://ptb.de/si" schemaLocation="https://ptb.de/si/v2.1.0/SI_Format.xsd"/>'
NETWORK = "line 2, xs:import: asks for https://ptb.de/si from https://ptb.de/si/v2.1.0/"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({}, "--schema FOLDER: holds no schema of a certificate; expected the schema file of https://ptb.de/dcc in"),
        ({"a.xsd": XSD.format("https://ptb.de/dcc", IMPORT)}, f"FOLDER/a.xsd, {NETWORK}"),
        ({"a.xsd": XSD.format("https://ptb.de/dcc", "<xs:none/>")}, "FOLDER/a.xsd: is not a valid schema: "),
        ({"a.xsd": XSD.format("https://ptb.de/dcc", "").replace("3.2.1", "3.3.0")}, "DCC, line 2, dcc:digitalCalib"),
    ],
)
def test_schemas_come_from_the_folder_only(files: dict[str, str], message: str, dcc: Path, tmp_path: Path) -> None:
    pytest.importorskip("xmlschema")
    (tmp_path / "xsd").mkdir()
    for name, text in files.items():
        (tmp_path / "xsd" / name).write_text(text, encoding="utf-8")
    error = refusal(CertificateError, check_dcc, dcc, tmp_path / "xsd")
    assert str(error).startswith(message.replace("FOLDER", str(tmp_path / "xsd")).replace("DCC", str(dcc)))


def test_the_library_is_named_with_its_extra(dcc: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xmlschema", None)
    error = refusal(ParameterError, check_dcc, dcc, dcc.parent)
    assert str(error).endswith("'xmlschema' is not installed; expected pip install 'posor[dcc]'.")


def test_a_new_certificate_file_names_all_blanks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lab.yaml"
    assert main(["new", str(path)]) == 0
    for same in (path, tmp_path / "missing" / ".." / "lab.yaml"):
        assert main(["new", str(same)]) == 1
        assert "exists already" in capsys.readouterr().err
    assert str(refusal(CalibrationError, load_certificate_file, path)) == (
        f"certificate file {path}: identifier, begin, end, laboratory.name, laboratory.location.city, "
        "laboratory.location.country, persons.0.name, customer.name, customer.location.city, "
        "customer.location.country missing; expected a text for each."
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2026-11-25", "2026-11-23", "line 4, key end: 2026-11-23 is before 2026-11-24; expected begin, end, issued"),
        ("end: 2026-11-25", "end: 2999-01-01", "is before 2999-01-01"),  # today is before it, or the clock is not set
        (
            "end: 2026-11-25",
            "end: 2026-11-25\nissued: 2999-01-01",
            "line 5, key issued: 2999-01-01 is in the future; expected",
        ),
        ("2026-11-25", "25.11.2026", "line 4, key end: '25.11.2026'; expected a date, such as 2026-11-26."),
        ("country: DE", "country: Germany", "'Germany'; expected two capital letters (ISO 3166-1), such as 'DE'."),
        ("place: laboratory", "place: shop", "line 5, key place: 'shop'; expected 'laboratory', 'customer',"),
        ("A. Metrologist", "''", "persons.0.name missing; expected a text for each."),
    ],
)
def test_certificate_files_that_are_refused(old: str, new: str, message: str, lab: Path) -> None:
    lab.write_text(CERTIFICATE.replace(old, new, 1), encoding="utf-8")
    assert message in str(refusal(CalibrationError, load_certificate_file, lab))


@pytest.mark.parametrize(
    ("unit", "dsi"),
    [
        ("m", r"\metre"),
        ("1", r"\one"),
        ("1/K", r"\kelvin\tothe{-1}"),
        ("m/s^2", r"\metre\second\tothe{-2}"),
        ("kg/m3", r"\kilogram\metre\tothe{-3}"),
        ("A/s^0.5", r"\ampere\second\tothe{-0.5}"),
        ("m/V^0", r"\metre"),
        ("m/V^k", ""),
        ("inch", ""),
        ("", ""),
    ],
)
def test_units_in_dsi(unit: str, dsi: str) -> None:
    assert to_dsi(unit) == dsi
    assert is_dsi(dsi) == bool(dsi)


def test_a_unit_without_a_name_in_dsi_is_refused(lab: Path) -> None:
    error = refusal(OutputError, dcc_xml, certificate(Quantity("slope", 1.0, "inch")), load_certificate_file(lab))
    assert str(error) == "certificate, slope: unit 'inch'; expected a unit of the SI, such as 'm' or 'm/V'."


@pytest.mark.parametrize("unit", [r"\milli\metre", r"\kilo\metre\per\hour", r"\degreecelsius", r"\percent"])
def test_other_units_of_dsi_are_known(unit: str) -> None:
    assert is_dsi(unit)
    assert not is_dsi(unit[:-1])
    assert not is_dsi(unit + " ")

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write a Digital Calibration Certificate (DCC 3.2.1, https://ptb.de/dcc/v3.2.1) of results with units in D-SI."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from posor.certificates.dsi_units import to_dsi
from posor.errors import OutputError
from posor.output_files import make_folder, write_files

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor.certificates.certificate_file import CertificateFile, Contact, Laboratory, Location, Person

SCHEMA_VERSION = "3.2.1"
DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
ET.register_namespace("dcc", DCC)
ET.register_namespace("si", SI)


@dataclass(frozen=True)
class Quantity:
    """A number of a certificate; without ``expanded`` no uncertainty is stated."""

    name: str
    value: float
    unit: str  # as in files, such as ``m/V``
    expanded: float | None = None
    factor: float = math.nan  # coverage factor
    probability: float = math.nan  # coverage probability
    distribution: str = "normal"


@dataclass(frozen=True)
class Block:
    """A named part of a certificate: a result or a condition, with quantities, sentences, or both."""

    name: str
    quantities: Sequence[Quantity] = ()
    sentences: Sequence[str] = ()


@dataclass(frozen=True)
class HashedFile:
    """A file that the results rest on."""

    role: str
    name: str
    sha256: str


@dataclass(frozen=True)
class Certificate:
    """Content of a certificate beside the certificate file."""

    title: str  # of the measurement
    item: str  # what is calibrated
    identifications: Mapping[str, str]  # of the item, by name; empty ones are left out
    software: tuple[str, str]  # name and release
    method: str
    norms: Sequence[str]
    files: Sequence[HashedFile]
    conditions: Sequence[Block]
    results: Sequence[Block]
    declarations: Mapping[str, Sequence[str]]  # sentences on the results, by title


def dcc_xml(certificate: Certificate, stated: CertificateFile) -> bytes:
    """Return a certificate as XML. Raises OutputError: a unit has no name in D-SI."""
    root = _dcc(
        "digitalCalibrationCertificate",
        _dcc(
            "administrativeData",
            _dcc("dccSoftware", _software(certificate)),
            _core_data(stated),
            _dcc("items", _item(certificate, stated)),
            _laboratory(stated.laboratory),
            _dcc("respPersons", *map(_person, stated.persons)),
            _contact("customer", stated.customer),
            _list("statements", (_declaration(*each) for each in certificate.declarations.items() if each[1])),
        ),
        _dcc("measurementResults", _measurement(certificate)),
    )
    root.set("schemaVersion", SCHEMA_VERSION)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True))


def write_dcc(path: Path, certificate: Certificate, stated: CertificateFile) -> None:
    """Write a certificate to a new file. Raises OutputError: it exists, or cannot be written."""
    check_new(path)
    content = dcc_xml(certificate, stated)
    make_folder(path.parent)
    write_files({path: content + b"\n"})


def check_new(path: Path) -> None:
    """Raise OutputError if a certificate exists already: it may have been issued."""
    if Path(os.path.realpath(path)).exists():  # unlike path.exists() also of 'missing/../file'
        raise OutputError("exists already", where=str(path), expected="a new file for the certificate")


def _element(tag: str, children: Iterable[ET.Element | str | None]) -> ET.Element:
    made = ET.Element(tag)
    for child in children:
        if isinstance(child, str):
            made.text = _NO_XML.sub(lambda match: f"\\x{ord(match[0]):02x}", child.strip())
        elif child is not None:
            made.append(child)
    return made


def _dcc(name: str, *children: ET.Element | str | None) -> ET.Element:
    return _element(f"{{{DCC}}}{name}", children)


def _si(name: str, *children: ET.Element | str | None) -> ET.Element:
    return _element(f"{{{SI}}}{name}", children)


def _text(name: str, *sentences: str) -> ET.Element:
    """Return an element with a text in English for each sentence."""
    contents = [_dcc("content", sentence) for sentence in sentences]
    for each in contents:
        each.set("lang", "en")
    return _dcc(name, *contents)


def _maybe(name: str, text: str | None) -> ET.Element | None:
    return None if text is None else _dcc(name, text)


def _list(name: str, entries: Iterable[ET.Element]) -> ET.Element | None:
    """Return a list, which a certificate leaves out if it is empty."""
    made = _dcc(name, *entries)
    return made if len(made) else None


def _software(certificate: Certificate) -> ET.Element:
    name, release = certificate.software
    return _dcc("software", _text("name", name), _dcc("release", release), _dcc("type", "application"))


def _core_data(stated: CertificateFile) -> ET.Element:
    return _dcc(
        "coreData",
        _dcc("countryCodeISO3166_1", stated.laboratory.location.country),
        _dcc("usedLangCodeISO639_1", "en"),
        _dcc("mandatoryLangCodeISO639_1", "en"),
        _dcc("uniqueIdentifier", stated.identifier),
        _dcc("beginPerformanceDate", stated.begin),
        _dcc("endPerformanceDate", stated.end),
        _dcc("performanceLocation", stated.place),
        _dcc("issueDate", stated.day_of_issue),
    )


def _item(certificate: Certificate, stated: CertificateFile) -> ET.Element:
    maker = None if stated.manufacturer is None else _dcc("manufacturer", _text("name", stated.manufacturer))
    identifications = [
        _dcc("identification", _dcc("issuer", "other"), _dcc("value", value), _text("name", name))
        for name, value in certificate.identifications.items()
        if value
    ]
    return _dcc(
        "item",
        _text("name", certificate.item),
        maker,
        _maybe("model", stated.model),
        _dcc("identifications", *identifications),
    )


def _laboratory(laboratory: Laboratory) -> ET.Element:
    code = _maybe("calibrationLaboratoryCode", laboratory.code)
    return _dcc("calibrationLaboratory", code, _contact("contact", laboratory))


def _contact(name: str, contact: Contact) -> ET.Element:
    return _dcc(
        name,
        _text("name", contact.name),
        _maybe("eMail", contact.email),
        _maybe("phone", contact.phone),
        _location(contact.location),
    )


def _location(place: Location) -> ET.Element:
    fields = {"street": place.street, "streetNo": place.number, "postCode": place.post_code, "city": place.city}
    return _dcc("location", *(_maybe(name, text) for name, text in fields.items()), _dcc("countryCode", place.country))


def _person(person: Person) -> ET.Element:
    who = _dcc("person", _text("name", person.name), _maybe("eMail", person.email))
    return _dcc("respPerson", who, _maybe("role", person.role), _dcc("mainSigner", str(person.signs).lower()))


def _declaration(title: str, sentences: Sequence[str]) -> ET.Element:
    return _dcc("statement", _text("name", title), _text("declaration", *sentences))


def _measurement(certificate: Certificate) -> ET.Element:
    method = _dcc("usedMethod", _text("name", certificate.method), *(_dcc("norm", norm) for norm in certificate.norms))
    return _dcc(
        "measurementResult",
        _text("name", certificate.title),
        _dcc("usedMethods", method),
        _dcc("usedSoftware", _software(certificate)),
        _list("measuringEquipments", map(_equipment, certificate.files)),
        _list(
            "influenceConditions", (_dcc("influenceCondition", *_named_data(each)) for each in certificate.conditions)
        ),
        _dcc("results", *(_dcc("result", *_named_data(each)) for each in certificate.results)),
    )


def _equipment(file: HashedFile) -> ET.Element:
    certificate = _dcc(
        "certificate",
        _text("referral", file.role),
        _dcc("referralID", file.name),
        _dcc("procedure", "SHA-256"),
        _dcc("value", file.sha256),
    )
    return _dcc("measuringEquipment", _text("name", file.role), certificate)


def _named_data(block: Block) -> list[ET.Element]:
    texts = [_text("text", *block.sentences)] if block.sentences else []
    return [_text("name", block.name), _dcc("data", *texts, *map(_quantity, block.quantities))]


def _quantity(quantity: Quantity) -> ET.Element:
    unit, expanded = to_dsi(quantity.unit), quantity.expanded
    if not unit:
        expected = "a unit of the SI, such as 'm' or 'm/V'"
        raise OutputError(f"unit '{quantity.unit}'", where=f"certificate, {quantity.name}", expected=expected)
    if not math.isfinite(quantity.value) or not math.isfinite(expanded or 0.0):
        value = (
            "without bound"
            if not math.isfinite(quantity.value)
            else f"{quantity.value!r} {quantity.unit}, uncertainty without bound"
        )
        return _dcc("quantity", _text("name", quantity.name), _text("noQuantity", value))
    uncertainty = None
    if expanded is not None:
        uncertainty = _si(
            "expandedUnc",
            _si("uncertainty", repr(expanded)),
            _si("coverageFactor", format(Decimal(repr(quantity.factor)), "f")),
            _si("coverageProbability", format(Decimal(repr(quantity.probability)), "f")),
            _si("distribution", quantity.distribution),
        )
    real = _si("real", _si("value", repr(quantity.value)), _si("unit", unit), uncertainty)
    return _dcc("quantity", _text("name", quantity.name), real)

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The certificate file, version 1: what a calibration certificate states about laboratory, persons and customer."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, StringConstraints, ValidationError, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.calibration.yaml_document import load_document
from posor.errors import CalibrationError

FILE_KIND = "certificate file"
VERSION = 1
TEMPLATE = Path(__file__).with_name("certificate_template.yaml")
"""A certificate file to be filled in."""


def _check_country(text: str) -> str:
    if len(text) != 2 or not (text.isascii() and text.isupper()):  # noqa: PLR2004  letters of ISO 3166-1
        raise EntryError(format_value(text), expected="two capital letters (ISO 3166-1), such as 'DE'")
    return text


def _check_date(text: str) -> str:
    try:
        return dt.date.fromisoformat(text).isoformat()
    except ValueError:
        raise EntryError(format_value(text), expected="a date, such as 2026-11-26") from None


Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
Country = Annotated[Text, AfterValidator(_check_country)]
Date = Annotated[Text, AfterValidator(_check_date)]


class Location(FrozenModel):
    """A postal address."""

    street: Text | None = None
    number: Text | None = None
    post_code: Text | None = None
    city: Text
    country: Country


class Contact(FrozenModel):
    """A laboratory or a customer."""

    name: Text
    email: Text | None = None
    phone: Text | None = None
    location: Location


class Laboratory(Contact):
    """The laboratory that issues the certificate."""

    code: Text | None = None  # of its accreditation


class Person(FrozenModel):
    """A responsible person; ``signs``: the main signer."""

    name: Text
    role: Text | None = None
    email: Text | None = None
    signs: bool = False


class CertificateFile(FrozenModel):
    """Content of a certificate file."""

    version: Literal[1]
    identifier: Text  # unique number of the certificate
    begin: Date  # first and last day of the calibration
    end: Date
    issued: Date | None = None
    place: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
    manufacturer: Text | None = None  # of the calibrated item
    model: Text | None = None
    laboratory: Laboratory
    persons: Annotated[tuple[Person, ...], Field(min_length=1)]
    customer: Contact

    @property
    def day_of_issue(self) -> str:
        """Day of the certificate: as stated, or today."""
        return self.issued or dt.datetime.now(dt.UTC).date().isoformat()

    @model_validator(mode="after")
    def _check_order(self) -> CertificateFile:
        for key, first, last in (("end", self.begin, self.end), ("issued", self.end, self.day_of_issue)):
            if last < first:
                what = f"{last} is before {first}" if getattr(self, key) else f"{key} today, {last}, is before {first}"
                raise EntryError(what, key=(key,), expected="begin, end, issued in this order")
        tomorrow = (dt.datetime.now(dt.UTC).date() + dt.timedelta(days=1)).isoformat()  # UTC may be a day behind
        if self.day_of_issue > tomorrow:
            raise EntryError(f"{self.day_of_issue} is in the future", key=("issued",), expected="today or earlier")
        return self


def load_certificate_file(path: Path) -> CertificateFile:
    """Read a certificate file.

    Raises CalibrationError: the file cannot be read, or has invalid content; one sentence names all fields that are
    missing or blank.
    """

    def validate(content: dict[str, Any]) -> CertificateFile:
        try:
            return CertificateFile.model_validate(content)
        except ValidationError as error:
            problems = error.errors()
            blank = [each for each in problems if each["type"] == "missing" or each["input"] in (None, "", [])]
            if not blank:
                raise
            names = ", ".join(dict.fromkeys(".".join(map(str, each["loc"])) for each in blank))
            raise CalibrationError(
                f"{names} missing", where=f"{FILE_KIND} {path}", expected="a text for each"
            ) from error

    keys = "identifier, begin, end, place, laboratory, persons, customer"
    return load_document(path, FILE_KIND, keys, VERSION, validate)[0]

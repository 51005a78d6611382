# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A certificate file for tests, the schema files of DCC and D-SI, and certificates read without our code."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.dom import minidom

import pytest

SCHEMA = Path(os.environ.get("DCC_SCHEMA") or "/nonexistent")
needs_schema = pytest.mark.skipif(
    not SCHEMA.is_dir() or find_spec("xmlschema") is None, reason="DCC_SCHEMA names no folder, or xmlschema is missing"
)
CERTIFICATE = """\
version: 1
identifier: POSOR-2026-001
begin: 2026-11-24
end: 2026-11-25
place: laboratory
laboratory:
  name: Calibration Laboratory
  code: D-K-00000
  location: {street: Main Street, number: '1', post_code: '12345', city: Lab City, country: DE}
persons:
- name: A. Metrologist
  role: head
  signs: true
customer:
  name: Robot Shop & Sons
  location:
    city: Shop City
    country: US
"""


def read_dcc(path: Path) -> minidom.Document:
    """Return a certificate by another library than that which writes it."""
    return minidom.parse(str(path))  # noqa: S318  written by the test


def texts(node: Any, name: str) -> list[str]:
    """Return the texts of all elements of a name, with its prefix."""
    return [each.firstChild.data for each in node.getElementsByTagName(name)]


def quantities(document: minidom.Document) -> dict[str, Any]:
    """Return the quantities of results and conditions, which are not nested, by name."""
    found = {texts(each, "dcc:content")[0]: each for each in document.getElementsByTagName("dcc:quantity")}
    assert len(found) == len(document.getElementsByTagName("dcc:quantity"))  # noqa: S101
    return found


def numbers(quantity: Any) -> list[float]:
    """Return value, expanded uncertainty, coverage factor and probability."""
    keys = ("si:value", "si:uncertainty", "si:coverageFactor", "si:coverageProbability")
    return [float(texts(quantity, key)[0]) for key in keys]

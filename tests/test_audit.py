# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The audit of the pinned libraries where it is not possible: one sentence, and an exit code that is no success."""

from __future__ import annotations

import os
from pathlib import Path

import audit_requirements
import pytest

CLOSED = "http://127.0.0.1:9"  # nothing listens there


@pytest.fixture(autouse=True)
def _fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit_requirements, "TOOL", tmp_path)


def refused(capfd: pytest.CaptureFixture[str]) -> str:
    """Run the audit, which is not possible, and return its one sentence."""
    capfd.readouterr()
    assert audit_requirements.main() == audit_requirements.NOT_POSSIBLE
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.endswith("; expected a connection to pypi.org.\n")
    return err


def test_without_an_index_the_audit_is_refused(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for name, value in {"NO_INDEX": "1", "FIND_LINKS": "", "CONFIG_FILE": os.devnull}.items():
        monkeypatch.setenv(f"PIP_{name}", value)
    said = "make audit: pip-audit cannot be installed: ERROR: No matching distribution found for "
    assert refused(capfd).startswith(said)


@pytest.mark.long
def test_without_the_database_the_audit_is_refused(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    assert audit_requirements.install_tool() == ""
    for name in ("HTTPS_PROXY", "https_proxy"):
        monkeypatch.setenv(name, CLOSED)
    assert refused(capfd).startswith("make audit: the database of vulnerabilities cannot be read: ")

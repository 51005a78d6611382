# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of devices that another package registers and that cannot be loaded: refused where a file names them."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest
from posor.calibration.file_model import EntryError, select_model_by_key
from posor.plugins import registered
from posor_drivers.instruments import device
from posor_lab.harness.case_tables import refusal


def test_a_kind_that_cannot_be_loaded_is_refused_only_where_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = EntryPoint("broken", "no_such_module:Box", device.ENTRY_POINT_GROUP)
    kinds = {**registered(device.ENTRY_POINT_GROUP), "broken": broken}
    monkeypatch.setattr(device, "registered", lambda _group: kinds)
    found = device.settings_of_kinds()
    assert {kind for kind, settings in found.items() if isinstance(settings, EntryError)} == {"broken"}
    select = select_model_by_key("kind", found).func
    error = refusal(EntryError, select, {"kind": "broken"})
    assert (error.key, error.what) == (
        ("kind",),
        "no_such_module:Box cannot be loaded, No module named 'no_such_module'",
    )

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that several files share."""

from __future__ import annotations

import pytest


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw 1000 times for an error budget, to save time; ``test_monte_carlo`` and ``made`` draw as often as a user."""
    for module in ("monte_carlo", "budget_command"):
        monkeypatch.setattr(f"posor_design.{module}.BATCH", 500)
    monkeypatch.setattr("posor_design.posor_design_command.BUDGET_DRAWS", 1000)

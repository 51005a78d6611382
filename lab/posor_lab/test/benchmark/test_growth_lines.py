# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

import pytest
from posor_lab.benchmark.growth_lines import fit_line, growth_page, select_series


def point(joints: int, rate: int, cores: float, lost: int = 0) -> dict[str, Any]:
    return {"joints": joints, "rate": rate, "cpu_cores": cores, "lost": lost, "expected": 1000}


def test_line_leaves_out_overloaded_points() -> None:
    points = [point(16, 500, 0.9, lost=300), *(point(joints, 500, 0.02 + 0.03 * joints) for joints in (4, 1, 2))]
    line = fit_line(select_series([*points, point(1, 4000, 0.7)], "joints", 500), "joints")
    assert line is not None
    assert line.at == [1.0, 2.0, 4.0]
    assert (line.cores_at_zero, line.cores_each) == pytest.approx((0.02, 0.03))
    assert line.residuals_cores == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert fit_line(points[:2], "joints") is None
    page = growth_page([*points, point(6, 500, 0.2), point(6, 2000, 0.5)], 6, 500)
    assert "6 graphs measured, 1 overloaded." in page
    assert all(text in page for text in ("straight line", "residuals by rate", "All nodes in one process, 6 joints"))

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Differences of two calibrations, in sigmas."""

from __future__ import annotations

import math
from typing import Any

import pytest
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.designs import design
from posor.calibration.fit_record import FitRecord, RecordedData
from posor_calibration.calibration_comparison import compare_calibrations


def changed(**of_probe: Any) -> Calibration:
    content = design("triad_diodes").model_dump(mode="json", exclude_none=True)
    content["sensors"][0]["probes"][1] |= of_probe
    return calibration_from(content)


def test_the_same_calibration_does_not_differ() -> None:
    found = compare_calibrations(design("triad_diodes"), changed())
    assert (found.differences, found.others) == ((), ())
    assert found.compared > 100


def test_the_largest_difference_in_sigmas_comes_first() -> None:
    tip = [1e-5, 0.0381 + 4e-5, 0.0]
    first = changed(tip={"value": [0.0, 0.0381, 0.0], "sigma": [2e-5, 3e-5, 0.0], "unit": "m"})
    second = changed(tip={"value": tip, "sigma": [2e-5, 4e-5, 1e-6], "unit": "m"})
    found = compare_calibrations(first, second)
    assert [d.name for d in found.differences] == [f"sensors[0].probes[1].tip[{i}]" for i in (1, 0, 2)]
    large, small, only_sigma = found.differences
    assert large.sigmas == pytest.approx(0.8)
    assert small.sigmas == pytest.approx(1e-5 / math.hypot(2e-5, 2e-5))
    assert (only_sigma.sigmas, only_sigma.second_sigma) == (0.0, 1e-6)
    assert (large.first, large.second, large.unit) == (0.0381, 0.0381 + 4e-5, "m")
    assert (large.first_sigma, large.second_sigma) == (3e-5, 4e-5)
    assert not found.descended
    one, other = (changed(noise={"value": value, "unit": "V"}) for value in (1e-3, 2e-3))
    assert compare_calibrations(one, other).differences[0].sigmas == math.inf  # both are exact


def test_a_calibration_fitted_from_the_first_differs_in_sigmas_of_the_first() -> None:
    first = changed(zero_shift={"value": 0.0, "sigma": 5e-4, "unit": "V"})
    second = changed(zero_shift={"value": 1e-3, "sigma": 1e-5, "unit": "V"})
    record = FitRecord(
        procedure="bundle",
        method="test",
        date="2026-01-31T12:00:00Z",
        recording=RecordedData(name="bag", sha256=""),
        former=first.content_hash,
        replaced=["sensors[0].probes[1].zero_shift"],
    )
    found = compare_calibrations(first, second.model_copy(update={"version": 2, "fits": [record]}))
    assert found.descended
    [difference] = found.differences
    assert difference.name == "sensors[0].probes[1].zero_shift"
    assert difference.sigmas == pytest.approx(2.0)


def test_other_differences_are_sentences() -> None:
    content = design("triad_diodes").model_dump(mode="json", exclude_none=True)
    content["frames"]["child"] = "plate"
    content["sensors"][0]["probes"][0]["volts_to_gap"]["value"].append(0.0)
    content["sensors"][0]["probes"][0]["volts_to_gap"]["sigma"] = 0.0
    content["sessions"] = {"today": {"note": "a session"}}
    assert compare_calibrations(design("triad_diodes"), calibration_from(content)).others == (
        "sessions.today.note is only in the second.",
        "frames.child is 'target' in the first, 'plate' in the second.",
        "sensors[0].probes[0].volts_to_gap has another shape or unit.",
    )

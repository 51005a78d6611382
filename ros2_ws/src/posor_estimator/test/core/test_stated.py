"""What a calibration file states of how its numbers vary together: blocks of fit records, one after the other."""

from __future__ import annotations

import datetime as dt
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from posor_estimator.core.calibrate.procedure import Outcome
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.replacement import JointCovariance, Replacement
from posor_estimator.core.calibrate.result import Run, applied, written
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.calibration.entries import entries_of
from posor_estimator.core.calibration.load import calibration_of
from posor_estimator.core.calibration.stated import root_of, stated_covariance
from posor_estimator.core.designs import design
from posor_estimator.core.forward import empty_scans
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration

FIRST, SECOND = "sensors[0].probes[0].zero_shift", "sensors[0].probes[1].zero_shift"
TILT = "sensors[0].target_plane.tilt"
RUN = Run("by_hand", {}, [], dt.datetime(2026, 1, 1, tzinfo=dt.UTC))
NOTHING = Recording(empty_scans(np.arange(1, dtype=np.int64)), {}, "bench")


def outcome(key: str, sigma: float, entries: tuple[str, ...], correlation: float, other: float) -> Outcome:
    matrix = np.array([[sigma**2, correlation * sigma * other], [correlation * sigma * other, other**2]])
    return Outcome("by hand", {}, (Replacement(key, 0.01, sigma),), covariances=(JointCovariance(entries, matrix),))


def correlation(calibration: Calibration, one: str, other: str) -> float:
    names = [entry.name if entry else "" for entry in entries_of(calibration)]
    stated = stated_covariance(calibration)
    i, j = names.index(one), names.index(other)
    return float(stated[i, j] / np.sqrt(stated[i, i] * stated[j, j]))


def test_a_file_without_fits_states_standard_uncertainties() -> None:
    calibration = design("triad_diodes")
    np.testing.assert_allclose(
        stated_covariance(calibration), np.diag(np.square(Posor(calibration).stack.parameter_sigmas)), rtol=1e-12
    )


def test_later_records_replace_what_earlier_ones_stated() -> None:
    one = applied(design("triad_diodes"), outcome(FIRST, 2e-4, (FIRST, f"{TILT}[0]"), 0.8, 20e-6), NOTHING, RUN)
    assert correlation(one, FIRST, f"{TILT}[0]") == pytest.approx(0.8)
    two = applied(one, outcome(SECOND, 1e-4, (SECOND, FIRST), -0.5, 2e-4), NOTHING, RUN)
    assert correlation(two, FIRST, f"{TILT}[0]") == pytest.approx(0.8)
    assert correlation(two, SECOND, FIRST) == pytest.approx(-0.5)
    assert correlation(two, SECOND, f"{TILT}[0]") == pytest.approx(0.0)
    new = Outcome("by hand", {}, (Replacement(FIRST, 0.0, 1e-4),))
    three = applied(two, new, NOTHING, RUN)
    assert correlation(three, SECOND, FIRST) == pytest.approx(0.0)
    sigmas = np.sqrt(np.diag(stated_covariance(three)))
    np.testing.assert_allclose(sigmas, Posor(three).stack.parameter_sigmas, rtol=1e-12)


def test_roots_square_to_the_covariance_even_where_it_has_no_breadth() -> None:
    covariance = np.diag([4.0, 0.0, 1.0])
    covariance[0, 2] = covariance[2, 0] = 2.0
    root = root_of(covariance)
    assert root.shape == (3, 1)
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-12)


def test_changes_in_memory_are_those_of_the_file() -> None:
    calibration = design("triad_diodes")
    text = yaml.safe_dump(calibration.model_dump(mode="json", exclude_defaults=True), sort_keys=False)
    found = outcome(FIRST, 2e-4, (FIRST, f"{TILT}[0]"), 0.8, 20e-6)
    in_memory = applied(calibration, found, NOTHING, RUN)
    assert in_memory.content_hash == calibration_of(written(text, "file", found, NOTHING, RUN), "file").content_hash


def test_more_correlation_than_there_can_be_is_not_written() -> None:
    taken = Taken(design("triad_diodes"), np.zeros(0, dtype=np.int64))
    across = np.zeros((1, taken.root.shape[1]))
    across[0, 3] = 1.5
    joint = taken.beside((FIRST,), np.eye(1), across)
    assert np.min(np.linalg.eigvalsh(joint.matrix / np.outer(*[np.sqrt(np.diag(joint.matrix))] * 2))) > -1e-9

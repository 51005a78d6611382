# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Printed tables of the thesis on the motion tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor.errors import DataFileError
from posor_lab.replay_1985.printed_results import (
    EXPECTED_ERRORS_FILE,
    PRINTED_FILES,
    PredictedError,
    PrintedColumns,
    read_predicted_errors,
    read_printed,
)
from posor_lab.thesis_data import URAD, data_path


def test_printed_columns_are_read(printed: PrintedColumns) -> None:
    assert printed.posor.shape == printed.truth.shape == (15, 3)
    assert printed.posor[-1] / URAD == pytest.approx([71.0, 4191.0, -243.0])
    assert printed.truth[-1] / URAD == pytest.approx([0.0, 4318.0, -13.0])


@pytest.mark.parametrize(
    ("test", "angle", "constant", "increasing"),
    [
        ("ymo", "alpha", 28.0, 0.0),
        ("ymo", "beta", 6.0, 13.0),
        ("ymo", "theta", 55.0, 0.0),
        ("yzmo", "beta", 6.0, 13.0),
        ("yzmo", "theta", 49.0, 0.0),
        ("zmo", "alpha", 11.0, 0.0),
        ("zmo", "beta", 6.0, 0.0),
        ("zmo", "theta", 72.0, 0.0),
    ],
)
def test_predicted_errors_are_those_of_section_8_4(test: str, angle: str, constant: float, increasing: float) -> None:
    predictions = {
        str(name): each for name, each in read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), test).items()
    }
    assert predictions[angle].constant / URAD == pytest.approx(constant)
    assert predictions[angle].increasing / URAD == pytest.approx(increasing)


def test_the_error_band_widens_with_the_motion() -> None:
    predicted = PredictedError(6e-6, 13e-6, "")
    np.testing.assert_allclose(predicted.half_width(np.array([0.0, -2.0, 4.0])), [6e-6, 12.5e-6, 19e-6])
    np.testing.assert_allclose(predicted.half_width(np.zeros(2)), [6e-6, 6e-6])


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("beta_posor_urad", "beta_urad", "column 'beta_posor_urad' is missing."),
        ("\n3,0,17,748", "\n3,0,l7,748", "step 3, column 'alpha_posor_urad': 'l7' is not a number; expected a number."),
        ("\n3,0,17", "\n4,0,17", "step '4' in row 3; expected step 3."),
        (
            "\n3,0,17",
            "\n3,0,,17",
            "row 3: another number of cells; expected 8 cells; a text with a comma is in quotation marks.",
        ),
    ],
)
def test_a_damaged_table_is_refused(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    text = data_path(PRINTED_FILES["ymo"]).read_text(encoding="utf-8")
    assert old in text
    damaged = tmp_path / "damaged.csv"
    damaged.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(DataFileError) as caught:
        read_printed(damaged)
    assert str(caught.value).startswith(str(damaged))
    assert str(caught.value).endswith(sentence)


def test_a_missing_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match=r"nowhere\.csv: cannot be read: No such file or directory"):
        read_printed(tmp_path / "nowhere.csv")


def test_a_prediction_of_unknown_terms_is_refused(tmp_path: Path) -> None:
    text = data_path(EXPECTED_ERRORS_FILE).read_text(encoding="utf-8")
    damaged = tmp_path / "expected_errors.csv"
    damaged.write_text(text.replace("random 6; increasing 13", "random 6; growing 13"), encoding="utf-8")
    with pytest.raises(DataFileError, match="test YMO, dof beta: 'growing 13' is not a predicted error"):
        read_predicted_errors(damaged, "ymo")

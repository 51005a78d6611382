"""Eight numbers abreast: every operation gives each of them what it gives one alone, to the last bit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.compiled import COMPILING, EIGHT
from posor_estimator.core.kernels.eight import ALIGNED, anywhere, chosen, eights, everywhere, opposite
from posor_estimator.core.kernels.reshaped import part

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

ROWS = 40
compiled_only = pytest.mark.skipif(not COMPILING, reason="there are no eights without numba")


def room(count: int) -> FloatArray:
    """Return zeros that begin where the processor wants eights."""
    whole = np.zeros(count + ALIGNED // 8)
    begin = -whole.ctypes.data % ALIGNED // 8
    return whole[begin : begin + count]


def everything(a: Any, b: Any, out: Any) -> None:
    """Do all there is with two numbers, be they one or eight."""
    out[0] = a + b * 2.0 - 1 / b
    out[1] = (3 - a) / (b * b)
    total = 0.0
    for _ in range(3):
        total += a
        total *= b
        total -= 1.0
        total /= 2.0
    out[2] = -total
    out[3] = min(a, b) + max(a, 0.5) * min(0.1, b)
    out[4] = math.sqrt(abs(a)) + math.floor(chosen(abs(b) < 1e9, b, 0.0))  # of one number floor is a whole one
    out[5] = math.sin(a) + math.cos(b) + math.atan2(a, b) + math.atan2(a, 1.0)
    out[6] = chosen((a < b) & (a <= 1.0), a, 7.0)
    out[7] = chosen((a > b) | (b >= 2.0) | (a == 0.0), 1, b)
    out[8] = chosen(opposite(a > 0.0), -1.0, 1.0)
    out[9] = b


@pytest.fixture
def numbers() -> tuple[FloatArray, FloatArray]:
    """Return numbers of all kinds, by row and turn."""
    random = np.random.default_rng(8)
    a, b = random.normal(size=(2, ROWS, EIGHT)) * 3.0
    a[3, 2], b[5, 1], a[7, :], b[8, 0] = 0.0, math.inf, math.nan, -0.0
    a[9, 4] = b[9, 4]
    return a, b


def compiled(function: Any) -> Any:
    import numba  # noqa: PLC0415  where it is installed

    return numba.njit(error_model="numpy")(function)


@compiled_only
def test_each_of_eight_is_what_it_is_alone(numbers: tuple[FloatArray, FloatArray]) -> None:
    a, b = numbers
    width = 10
    each = compiled(everything)

    @compiled
    def abreast(a: Any, b: Any, out: Any) -> None:
        all_a, all_b, table = eights(a), eights(b), eights(out)
        for n in range(all_a.shape[0]):
            each(all_a[n], all_b[n], part(table, n * width, 1, width)[0])

    flat_a, flat_b, together = room(a.size), room(b.size), room(a.size * width)
    flat_a[:], flat_b[:] = a.ravel(), b.ravel()
    abreast(flat_a, flat_b, together)
    alone = np.empty((ROWS, EIGHT, width))
    for n in range(ROWS):
        for turn in range(EIGHT):
            each(a[n, turn], b[n, turn], alone[n, turn])
    by_turn = together.reshape(ROWS, width, EIGHT).swapaxes(1, 2)
    np.testing.assert_array_equal(by_turn.view(np.uint64)[~np.isnan(alone)], alone.view(np.uint64)[~np.isnan(alone)])
    np.testing.assert_array_equal(np.isnan(by_turn), np.isnan(alone))
    assert np.isfinite(alone).mean() > 0.9


@compiled_only
@pytest.mark.parametrize(
    ("below", "answers"), [(EIGHT, (True, True)), (3, (False, True)), (0, (False, False))], ids=["all", "some", "none"]
)
def test_questions_are_answered_for_all_eight(below: int, answers: tuple[bool, bool]) -> None:
    @compiled
    def ask(numbers: Any) -> Any:
        condition = eights(numbers)[0] < 1.0
        return everywhere(condition), anywhere(condition)

    numbers = room(EIGHT)
    numbers[below:] = 2.0
    assert ask(numbers) == answers


@compiled_only
def test_a_number_that_becomes_eight_in_a_loop_is_eight_from_the_start() -> None:
    @compiled
    def longest(numbers: Any, out: Any) -> None:
        all_numbers, found = eights(numbers), 0.0
        for n in range(all_numbers.shape[0]):
            found = chosen(all_numbers[n] > found, all_numbers[n], found)
        eights(out)[0] = found

    numbers, out = room(3 * EIGHT), room(EIGHT)
    numbers[:] = np.random.default_rng(3).normal(size=numbers.size)
    longest(numbers, out)
    np.testing.assert_array_equal(out, np.maximum(numbers.reshape(3, EIGHT).max(axis=0), 0.0))


def test_of_single_numbers_they_are_what_they_are_in_python() -> None:
    assert chosen(True, 1.0, 2.0) == 1.0  # noqa: FBT003  kernels take no keywords
    assert chosen(False, 1.0, 2.0) == 2.0  # noqa: FBT003
    for condition in (True, False):
        assert everywhere(condition) == anywhere(condition) == condition
        assert opposite(condition) != condition

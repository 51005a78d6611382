# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Upper quantile and non-centrality of chi-square with a whole number of degrees of freedom.

``scipy.special`` has both; the nodes do without it, because its import is a large part of their start.

With t(k, x) = (x/2)^(k/2) exp(-x/2) / Gamma(k/2 + 1), chi-square of k degrees of freedom exceeds x with the probability

    t(k-2, x) + t(k-4, x) + ... + t(0, x)                        if k is even,
    t(k-2, x) + t(k-4, x) + ... + t(1, x) + erfc(sqrt(x/2))      if k is odd,

and with the non-centrality L it is below x with the probability

    sum over i >= 0 of  t(k+2i, x) P(i),    P(i): probability that a Poisson variable of mean L/2 is at most i.

Source: M. Abramowitz, I. A. Stegun, *Handbook of Mathematical Functions*, 1964, 26.4.4 to 26.4.6 and 26.4.25.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import accumulate
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

NEGLIGIBLE = 1e-18  # terms below this, of sums of order one


@lru_cache
def upper_quantile(degrees: int, probability: float) -> float:
    """Return the value that chi-square of ``degrees`` degrees of freedom exceeds with a probability.

    Raises ValueError: the probability is not between 0 and 1.
    """
    if not 0.0 < probability < 1.0:
        message = f"the probability is {probability}; expected above 0 and below 1"
        raise ValueError(message)

    def exceeded(value: float) -> float:
        rest = math.erfc(math.sqrt(0.5 * value)) if degrees % 2 else 0.0
        return rest + sum(_term(degree, value) for degree in range(degrees % 2, degrees - 1, 2))

    return _bisect(exceeded, probability)


@lru_cache
def noncentrality(degrees: int, limit: float, probability: float) -> float:
    """Return the non-centrality with which chi-square is below a limit with a probability.

    ``degrees``: of freedom. Raises ValueError: chi-square is below the limit less often without non-centrality.
    """
    terms = [_term(degrees, limit)]
    while degrees + 2 * len(terms) < limit or terms[-1] > NEGLIGIBLE:
        terms.append(_term(degrees + 2 * len(terms), limit))

    if not 0.0 < probability < sum(terms):
        message = f"the probability is {probability}; expected above 0 and below {sum(terms):.3g}"
        raise ValueError(message)

    def below(value: float) -> float:
        poisson = accumulate(_term(2 * i, value) for i in range(len(terms)))
        return sum(term * at_most for term, at_most in zip(terms, poisson, strict=True))

    return _bisect(below, probability)


def _term(degrees: int, value: float) -> float:
    """Return t of the module's description; of an even number 2i the probability of i by Poisson's distribution."""
    half = 0.5 * degrees
    return math.exp(half * math.log(0.5 * value) - 0.5 * value - math.lgamma(half + 1.0))


def _bisect(falling: Callable[[float], float], wanted: float) -> float:
    """Return the positive number at which a falling function has a value, to the last bit."""
    low, high = 0.0, 1.0
    while falling(high) > wanted:
        low, high = high, 2.0 * high
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if falling(middle) > wanted else (low, middle)
    return high

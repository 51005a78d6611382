"""Eight numbers abreast, which the processor computes with at once: the kernels' arithmetic for eight POSORs together.

A kernel that asks nothing of its numbers but by the functions of this module, and that calls no other function of
numbers than ``abs``, ``min`` and ``max`` of two, and those of ``math`` that ``eight_functions`` names, is compiled for
single numbers and for eights alike. Each of the eight comes out as it would alone, to the last bit: the same operations
in the same order.

Where kernels are not compiled there are no eights, and these functions are what they are for single numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import COMPILING, EIGHT

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

ALIGNED = 8 * EIGHT
"""A multiple of what the address of an array of eights must be [bytes]."""


def chosen(condition: bool, a: float, b: float) -> float:  # noqa: FBT001  kernels take no keywords
    """Return ``a`` where the condition holds, else ``b``; both have been computed."""
    return a if condition else b


def everywhere(condition: bool) -> bool:  # noqa: FBT001
    """Return whether the condition holds; of eight numbers, whether it does for each."""
    return condition


def anywhere(condition: bool) -> bool:  # noqa: FBT001
    """Return whether the condition holds; of eight numbers, whether it does for any."""
    return condition


def opposite(condition: bool) -> bool:  # noqa: FBT001
    """Return whether the condition does not hold."""
    return not condition


def eights(numbers: FloatArray) -> FloatArray:
    """Return a flat array in which the numbers of eight POSORs take turns as one of eights, without copying."""
    message = "there are no eights where kernels are not compiled"
    raise NotImplementedError(message, numbers.shape)


if COMPILING:
    from posor_estimator.core.kernels import eight_functions, eights_in_numba

    eight_functions.register(chosen, everywhere, anywhere, opposite)
    eights = eights_in_numba.eights

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors that several quantities share, as calibration and beams files state them under ``shared``.

A term is one physical error, such as the scale of a length reference or the temperature of a calibration. The same name
in several files of one arm is the same error. ``sigma`` of a quantity is the rest of its uncertainty, of its own.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.calibration.quantity import Quantity, describe_shape
from posor.errors import CalibrationError, similar_name
from posor.model.scan import MAX_TERMS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")


class SharedTerm(FrozenModel):
    """One error and what it changes.

    ``uncertainty`` is its standard uncertainty, in any unit. ``relative`` states the relative change of quantities per
    unit of the error, ``change`` their change, each by the key of the quantity in the file, or of one component.
    """

    uncertainty: Quantity
    relative: dict[str, Quantity] = Field(default_factory=dict)
    change: dict[str, Quantity] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        value = self.uncertainty.value
        if not isinstance(value, float) or not value > 0.0:
            raise EntryError(f"uncertainty {format_value(value)}", key=("uncertainty",), expected="a number above 0")
        if not self.relative and not self.change:
            raise EntryError("the term changes no quantity", expected="quantities under 'relative' or 'change'")
        for kind, effects in (("relative", self.relative), ("change", self.change)):
            for key, effect in effects.items():
                if effect.sigmas.any():
                    raise EntryError("sigma", key=(kind, key, "sigma"), expected="no sigma: uncertainty holds it")
        return self


class SharedQuantity(NamedTuple):
    """Unit and shape of a quantity that terms may change."""

    unit: str
    shape: tuple[int, ...]


def check_shared_terms(
    terms: Mapping[str, SharedTerm], relative: Mapping[str, SharedQuantity], change: Mapping[str, SharedQuantity]
) -> None:
    """Check the names of the terms of a file, the keys of the quantities that they change, units and shapes.

    ``relative``, ``change``: the quantities of the file, by key. Raises EntryError: an entry under ``shared`` is wrong.
    """
    if len(terms) > MAX_TERMS:
        raise EntryError(f"{len(terms)} shared terms", key=("shared",), expected=f"at most {MAX_TERMS}")
    for name, term in terms.items():
        if not _NAME.fullmatch(name):
            expected = "a letter, then letters, digits and underscores, at most 64"
            raise EntryError(f"name {format_value(name)}", key=("shared", name), expected=expected)
        by = term.uncertainty.unit
        for key, effect in term.relative.items():
            where = ("shared", name, "relative", key)
            shape = _known(relative, key, where).shape
            _check_effect(effect, where, _per("1", by), dict.fromkeys([(), shape]))
        for key, effect in term.change.items():
            where = ("shared", name, "change", key)
            known = _known(change, key, where)
            _check_effect(effect, where, _per(known.unit, by), [known.shape])


def _per(unit: str, by: str) -> str:
    return "1" if unit == by else unit if by == "1" else f"{unit}/{by}"


def _known(quantities: Mapping[str, SharedQuantity], key: str, where: tuple[str, ...]) -> SharedQuantity:
    if key not in quantities:
        expected = similar_name(key, quantities, "the key of a quantity that enters the measurement")
        raise EntryError(f"unknown quantity '{key}'", key=where, expected=expected)
    return quantities[key]


def _check_effect(effect: Quantity, where: tuple[str, ...], unit: str, shapes: Iterable[tuple[int, ...]]) -> None:
    if effect.unit != unit:
        raise EntryError(f"unit '{effect.unit}'", key=(*where, "unit"), expected=f"'{unit}'")
    if effect.array.shape not in shapes:
        expected = " or ".join(describe_shape(shape) for shape in shapes)
        raise EntryError(f"value has {describe_shape(effect.array.shape)}", key=(*where, "value"), expected=expected)


def check_same_terms(files: Mapping[str, Mapping[str, SharedTerm]]) -> None:
    """Check that a term has the same standard uncertainty in all files of an arm; ``files``: terms by file.

    Raises CalibrationError: two files differ; names both.
    """
    first: dict[str, tuple[str, SharedTerm]] = {}
    for file, terms in files.items():
        for name, term in terms.items():
            other, known = first.setdefault(name, (file, term))
            own, same = ((each.uncertainty.number, each.uncertainty.unit) for each in (term, known))
            if own != same:
                what = f"shared term '{name}' has the standard uncertainty {own[0]:g} {own[1]}"
                raise CalibrationError(what, where=file, expected=f"{same[0]:g} {same[1]}, as in {other}")


def effect_on(term: SharedTerm, key: str, value: np.ndarray) -> np.ndarray:
    """Return the change of a quantity by one standard uncertainty of a term, in the shape of its ``value``."""
    change = np.zeros(np.shape(value))
    if key in term.relative:
        change = change + term.relative[key].array * value
    if key in term.change:
        change = change + term.change[key].array
    return np.asarray(term.uncertainty.number * change)

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Causes of faults of a POSOR: which readings one physical cause moves together, and by how much at most.

A calibration file changes the causes of its design under ``causes``: an entry with the name of a default cause replaces
that cause, any other entry is a further cause. A cause that a calibration cannot have, such as one of diodes, is left
out of its defaults. Bounds without a measurement behind them are labelled "assumed".

Source: RTCA DO-229 and the integrity concept of ARAIM for satellite navigation (threat model, nominal biases b_nom).
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.errors import similar_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

FALSE_ALARM = 1e-4
"""Default probability that the test of the redundant readings of a joint rejects a sound scan of one arm."""
EXCEEDED = 1e-2
"""Largest share of joints, over all calibrations, whose own rate of false alarms may exceed that probability.

The errors of one calibration are the same in all of its scans, so joints differ in their rates. The test is therefore
set to a mean rate of EXCEEDED times the probability: by Markov's inequality no more joints than that exceed it."""
MAX_CAUSES = 64  # bound of the causes of ``posor_msgs/JointTransform``
MAX_NAME = 64  # longest name of a cause [characters]


class Readings(StrEnum):
    """Which readings of a POSOR a cause may move."""

    ALL = "all readings"
    GAPS = "gap probes"
    RING = "ring probes"
    PROBES = "gap and ring probes"
    DIODES = "diodes"


class Pattern(StrEnum):
    """How a cause moves them: each pattern is one or more hypotheses of one or two parameters."""

    EACH = "each by itself"
    SUBSETS = "any two or more, by the same amount"
    COMMON = "all by the same amount"
    GRADIENT = "by a plane over the places of the probes"
    PLANE_EACH = "both coordinates of each diode, in any direction"
    PLANE_COMMON = "both coordinates of all diodes alike, in any direction"
    DIODE_EACH = "both coordinates of each diode, by one amount"


class Move(NamedTuple):
    """What ``moves`` of a cause means."""

    readings: Readings
    pattern: Pattern
    units: Mapping[str, str]  # by what the cause acts, for each unit in which its size may be stated


_LENGTH = {"m": "length"}
_PROBE = {"m": "length", "V": "voltage", "1": "gain"}
MOVES: Mapping[str, Move] = {
    "one reading": Move(Readings.ALL, Pattern.EACH, _LENGTH),
    "one gap probe": Move(Readings.GAPS, Pattern.EACH, _PROBE),
    "all gap probes": Move(Readings.GAPS, Pattern.COMMON, _PROBE),
    "some gap probes": Move(Readings.GAPS, Pattern.SUBSETS, _PROBE),
    "gradient of gaps": Move(Readings.GAPS, Pattern.GRADIENT, _LENGTH),
    "one ring probe": Move(Readings.RING, Pattern.EACH, _PROBE),
    "all ring probes": Move(Readings.RING, Pattern.COMMON, _PROBE),
    "some ring probes": Move(Readings.RING, Pattern.SUBSETS, _PROBE),
    "gradient of ring probes": Move(Readings.RING, Pattern.GRADIENT, _LENGTH),
    "all probes": Move(Readings.PROBES, Pattern.COMMON, _PROBE),
    "some probes": Move(Readings.PROBES, Pattern.SUBSETS, _PROBE),
    "supply channel": Move(Readings.PROBES, Pattern.COMMON, {"V": "supply"}),
    "temperature channel": Move(Readings.PROBES, Pattern.COMMON, {"K": "temperature"}),
    "one spot": Move(Readings.DIODES, Pattern.PLANE_EACH, _LENGTH),
    "all spots": Move(Readings.DIODES, Pattern.PLANE_COMMON, _LENGTH),
    "one contact": Move(Readings.DIODES, Pattern.EACH, {"1": "contact"}),
    "contacts of one diode": Move(Readings.DIODES, Pattern.PLANE_EACH, {"1": "contact"}),
    "same contacts of all diodes": Move(Readings.DIODES, Pattern.PLANE_COMMON, {"1": "contact"}),
    "ambient light on one diode": Move(Readings.DIODES, Pattern.DIODE_EACH, {"1": "ambient"}),
    "ambient light on all diodes": Move(Readings.DIODES, Pattern.COMMON, {"1": "ambient"}),
}
"""Phrases for ``moves``. Units: ``1`` of probes is the relative change of the voltage, of contacts that of a contact
current, of ambient light its photocurrent as a share of that of the light source."""


class Cause(FrozenModel):
    """One physical cause of errors of several readings.

    ``moves`` is a key of ``MOVES``, ``bound`` the largest size in ``unit``, ``source`` says where the bound comes from.
    A ``fault`` is rare: one at a time. An ``always`` is present within its bound in every scan. ``shared_by: arm``: the
    causes of this name of all joints are one, such as a reference voltage.
    """

    name: str
    moves: str
    unit: str
    bound: Annotated[float, Field(strict=True)] | None = None
    unlimited: bool = False
    source: str
    kind: Literal["fault", "always"] = "fault"
    shared_by: Literal["joint", "arm"] = "joint"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not 0 < len(self.name.encode()) <= MAX_NAME:
            raise EntryError(f"name {format_value(self.name)}", key=("name",), expected=f"1 to {MAX_NAME} characters")
        if self.moves not in MOVES:
            expected = similar_name(self.moves, MOVES, f"one of: {', '.join(MOVES)}")
            raise EntryError(f"moves '{self.moves}'", key=("moves",), expected=expected)
        units = MOVES[self.moves].units
        if self.unit not in units:
            expected = " or ".join(f"'{unit}'" for unit in units)
            raise EntryError(f"unit '{self.unit}' of '{self.moves}'", key=("unit",), expected=expected)
        if (self.bound is None) != self.unlimited:
            what = "both bound and unlimited" if self.unlimited else "neither bound nor unlimited"
            raise EntryError(what, expected="a bound, or 'unlimited: true'")
        if self.bound is not None and not 0.0 <= self.bound < math.inf:
            raise EntryError(f"bound {self.bound:g}", key=("bound",), expected="a finite number, zero or more")
        if self.kind == "always" and self.unlimited:
            raise EntryError("an unlimited cause of kind 'always'", key=("unlimited",), expected="a bound")
        if not self.source.strip():
            raise EntryError("source is empty", key=("source",), expected="where the bound comes from, or 'assumed'")
        return self

    @property
    def limit(self) -> float:
        """The bound; infinite: unlimited."""
        return math.inf if self.bound is None else self.bound

    @property
    def move(self) -> Move:
        """What ``moves`` means."""
        return MOVES[self.moves]


_FIRST = "single error, as in Baarda's data snooping"
_DEFAULTS: tuple[tuple[str, str, str, float, Literal["fault", "always"], str], ...] = (
    ("reading", "one reading", "m", math.inf, "fault", _FIRST),
    ("contact", "one contact", "1", math.inf, "fault", _FIRST),
    ("light spot", "one spot", "m", 5e-6, "fault", "assumed: light source or dirt moves its spot"),
    ("light spots", "all spots", "m", 5e-6, "fault", "assumed: the ring of light sources moves on the target"),
    ("contacts", "contacts of one diode", "1", 1e-3, "fault", "assumed: leakage or gain of two contacts"),
    ("channels of contacts", "same contacts of all diodes", "1", 1e-3, "fault", "assumed: gain of a channel"),
    ("ambient light on a diode", "ambient light on one diode", "1", 1e-3, "fault", "assumed: reflex, open cover"),
    ("ambient light", "ambient light on all diodes", "1", 1e-3, "always", "assumed: room light through gaps"),
    ("wedge of gaps", "gradient of gaps", "m", 2e-6, "fault", "assumed: film or growth with a gradient"),
    ("bit of gap converter", "some gap probes", "m", 2e-6, "fault", "assumed: a low bit is stuck"),
    ("growth of gaps", "all gap probes", "m", 5e-6, "always", "assumed: film, or growth of the probes' mounts"),
    ("gain of gaps", "all gap probes", "1", 1e-3, "always", "assumed: drift of the reference voltage"),
    ("gradient of ring", "gradient of ring probes", "m", 2e-6, "fault", "assumed: opposite probes, unequal growth"),
    ("bit of ring converter", "some ring probes", "m", 2e-6, "fault", "assumed: a low bit is stuck"),
    ("growth of ring", "all ring probes", "m", 1e-6, "always", "assumed: film, or growth of the ring"),
    ("gain of ring", "all ring probes", "1", 1e-3, "always", "assumed: drift of the reference voltage"),
    ("supply channel", "supply channel", "V", 0.02, "always", "assumed: accuracy of the channel"),
    ("temperature channel", "temperature channel", "K", 1.0, "always", "assumed: accuracy of the sensor"),
)
"""Name, ``moves``, unit, bound, kind and source of each default cause."""
DEFAULT_CAUSES: tuple[Cause, ...] = tuple(
    Cause(
        name=name,
        moves=moves,
        unit=unit,
        bound=None if bound == math.inf else bound,
        unlimited=bound == math.inf,
        source=source,
        kind=kind,
    )
    for name, moves, unit, bound, kind, source in _DEFAULTS
)
"""Causes of every design: what none of the readings of a calibration can show is left out."""

AMBIENT_CAUSES, GAIN_CAUSES = ("ambient light on a diode", "ambient light"), ("gain of gaps", "gain of ring")
"""Default causes whose bounds dark scans and a known voltage reduce."""


def check_causes(causes: Iterable[Cause]) -> None:
    """Check that the entries under ``causes`` have different names. Raises EntryError: two of them are alike."""
    known: set[str] = set()
    for number, cause in enumerate(causes):
        if cause.name in known:
            what = f"a second cause '{cause.name}'"
            raise EntryError(what, key=("causes", number, "name"), expected="different names")
        known.add(cause.name)


def all_causes(own: Iterable[Cause], reduced: Mapping[str, tuple[float, str]]) -> tuple[Cause, ...]:
    """Return the default causes, those that ``own`` (the file's) replaces, and the file's further ones.

    ``reduced``: by the name of a default cause, the bound that a part of the design leaves, and its source.
    """
    changes = {name: {"bound": bound, "source": source} for name, (bound, source) in reduced.items()}
    defaults = {each.name: each.model_copy(update=changes.get(each.name, {})) for each in DEFAULT_CAUSES}
    return tuple((defaults | {cause.name: cause for cause in own}).values())

"""The POSOR of a campaign: what is known of it as built, and what it truly is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from posor_drivers.simulator.randomness import Stream
from posor_estimator.core.calibrate.unknowns import Unknowns
from posor_estimator.core.calibration.edit import parsed
from posor_estimator.core.calibration.entries import entries_of
from posor_estimator.core.calibration.model import Calibration, calibration_from
from posor_estimator.core.designs import design
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray

PosorName = Literal["triad_diodes", "triad_bumpy_ring"]
POSORS: tuple[PosorName, ...] = ("triad_diodes", "triad_bumpy_ring")

_GAP_PROBE: Mapping[str, Any] = {
    "tip": [50e-6, 50e-6, 10e-6],
    "volts_to_gap": [0.13e-6, 2.4e-6, 5e-7, 5e-8, 5e-9],
    "zero_shift": 0.0,
    "supply.sensitivity": 5e-6,
    "supply.reference": 5e-4,
    "temperature.sensitivity": 0.0,
    "temperature.reference": 0.0,
}
_RING_PROBE: Mapping[str, Any] = {key: _GAP_PROBE[key] for key in _GAP_PROBE if key.startswith(("supply", "temp"))}
_MAP = [[20e-6 if i + j <= 3 else 0.0 for j in range(4)] for i in range(4)]  # noqa: PLR2004  the order of the map
AS_BUILT: Mapping[str, Mapping[str, Any]] = {
    "sensors[0].probes": _GAP_PROBE,
    "sensors[0].target_plane": {"tilt": 5e-4},
    "sensors[1].probes": _RING_PROBE,
    "sensors[1].diodes": {
        "origin": [1e-4, 1e-4, 30e-6],
        "x_axis": [0.0, 3e-3, 1e-3],
        "y_axis": [3e-3, 0.0, 1e-3],
    },
    "sensors[1].light_sources": {"origin": [50e-6, 50e-6, 20e-6], "direction": [3e-3, 3e-3, 0.0]},
    "sensors[1].maps": {"x": _MAP, "y": _MAP},
    "sensors[1].ring": {"mean_radius": 5e-6, "cos": 2e-6, "sin": 2e-6},
}
"""Standard uncertainty of what the shop leaves, before any calibration, by group and quantity; the rest is as designed.

Gap probes: mounted by hand, linearised to the maker's tolerance; their zero counts from where they are linearised, so
that it has no uncertainty on that day. Probes of a ring come linearised. The temperature is kept. Assumed, as the
designs are.
"""
DRIFT = 0.05
"""Standard deviation of the gap probes' zero drift from the day of their linearisation to the next [V]."""


def as_built(name: PosorName) -> Calibration:
    """Return what is known of a POSOR of a design before it is calibrated."""
    calibration = design(name)
    content: dict[str, Any] = calibration.model_dump(mode="json", exclude_defaults=True)
    content["name"] = f"{name}_as_built"
    content["provenance"]["notes"] = ["uncertainties as the shop leaves them, before any calibration"]
    for key in {entry.key for entry in entries_of(calibration) if entry is not None}:
        group = next((group for group in AS_BUILT if key.startswith(group)), None)
        if group is None:
            continue
        tail = next((tail for tail in AS_BUILT[group] if key.endswith(f".{tail}")), None)
        # Only the diodes have maps and only rings have a ring: the group's name says which sensor it is.
        if tail is not None:
            _at(content, key)["sigma"] = AS_BUILT[group][tail]
    return calibration_from(content)


def _at(content: Any, key: str) -> Any:
    for step in parsed(key):
        content = content[step]
    return content


@dataclass(frozen=True)
class Plant:
    """A POSOR as it truly is.

    Attributes:
        name: Of its design.
        seed: It was drawn with.
        known: What is known of it as built.
        first_day: Its sensors on the day on which its probes are linearised.
        later: The same when the probes' zeros have drifted.

    """

    name: PosorName
    seed: int
    known: Calibration
    first_day: Stack
    later: Stack

    @staticmethod
    def drawn(name: PosorName, seed: int) -> Plant:
        """Draw a POSOR from what is known of it as built, and its drift."""
        known = as_built(name)
        random = Stream(seed, "campaign", name, "truth").at()
        unknowns = Unknowns(known)
        values = unknowns.values(unknowns.start + unknowns.sigmas * random.normal(size=len(unknowns)))
        stack = Posor(known).stack
        names = list(stack.parameter_names)
        drifted = values.copy()
        drifted[[names.index(f"GapProbes.zero_shifts[{k}]") for k in range(3)]] += DRIFT * random.normal(size=3)
        return Plant(name, seed, known, stack.with_parameter_values(values), stack.with_parameter_values(drifted))

    def random(self, step: str) -> np.random.Generator:
        """Return the random numbers of one step."""
        return Stream(self.seed, "campaign", self.name, step).at()

    def truth(self) -> dict[str, float]:
        """Return the true value behind each number of the calibration file, the zeros as they are after the drift."""
        values: FloatArray = self.later.parameter_values
        return {
            entry.name: float(value)
            for entry, value in zip(entries_of(self.known), values, strict=True)
            if entry is not None
        }

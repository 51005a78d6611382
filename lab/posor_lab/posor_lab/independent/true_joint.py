# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Raw readings of one joint by its calibration file, for many poses of its target plate."""

from __future__ import annotations

import copy
import re
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from posor_lab.independent.diode_contacts import contact_currents, read_map
from posor_lab.independent.file_values import si_values
from posor_lab.independent.light_rays import DiodePlane, nearest_sources
from posor_lab.independent.probe_curve import ProbeCurve
from posor_lab.independent.probe_distance import ProbedPlane, RingProfile, ring_distances

if TYPE_CHECKING:
    from collections.abc import Mapping

FloatArray = NDArray[np.float64]

_ERROR_NAME = re.compile(r"(\w+)\.(\w+)\[([\d,]*)\]")
DARK_SUBTRACTED = 8  # STATUS_DARK_SUBTRACTED of posor_msgs/RawScan
_MOST_PARAMETERS = 2 * 32 * 32
"""Of the map of a diode."""


class TrueJoint:
    """A POSOR as it is: its calibration file, and how the real parts differ from it."""

    def __init__(self, content: Mapping[str, Any], session: str = "") -> None:
        """Read the sensors from the content of a calibration file, with a session applied.

        Raises ValueError: the file has another unit, or a kind of sensor or of tilt that this model does not know.
        """
        if content.get("tilt_angle", "this_scan") != "this_scan":
            what = "the tilt of the previous scan is a habit of 1985, no geometry; expected 'this_scan'"
            raise ValueError(what)
        replaced = content["sessions"][session] if session else {}
        self._sensors: list[_Sensor] = []
        for entry in content["sensors"]:
            kind = next((each for each in _SENSORS.values() if entry["type"] == each.TYPE), None)
            if kind is None:
                known = ", ".join(each.TYPE for each in _SENSORS.values())
                what = f"sensor of type '{entry['type']}'; expected one of {known}"
                raise ValueError(what)
            self._sensors.append(kind(entry, replaced))

    def with_errors(self, errors: Mapping[str, float]) -> Self:
        """Return a POSOR whose parts differ from the file.

        ``errors``: real value minus that of the file [SI], by names such as ``GapProbes.tips[0,2]``.

        Raises ValueError: a name is unknown.
        """
        by_kind: dict[type[_Sensor], dict[tuple[str, tuple[int, ...]], float]] = {
            kind: {} for kind in _SENSORS.values()
        }
        for name, error in errors.items():
            match = _ERROR_NAME.fullmatch(name)
            if match is None or match[1] not in _SENSORS:
                what = f"error of '{name}'; expected a name such as GapProbes.tips[0,2]"
                raise ValueError(what)
            if error:  # a padded coefficient does not exist, and has no error
                by_kind[_SENSORS[match[1]]][match[2], tuple(int(i) for i in match[3].split(",") if i)] = error
        other = copy.copy(self)
        other._sensors = [  # noqa: SLF001  a copy of the same class
            sensor.with_errors(by_kind[type(sensor)]) for sensor in self._sensors
        ]
        return other

    def readings(
        self,
        rotations: FloatArray,
        translations: FloatArray,
        supply_voltages: FloatArray | None = None,
        temperatures: FloatArray | None = None,
        lit_sources: NDArray[np.int64] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return the raw readings at poses of the target in the receiving plate, (n, 3, 3), (n, 3) [m], by field.

        Fields: ``gap_voltages``, ``ring_voltages`` (n, p) [V], ``diode_currents`` (n, d, 4) [A], ``lit_sources``
        (n, d), and ``reference_voltages`` (n,) [V] where the converter reads a known voltage; ``statuses``
        (n,) where ambient light is removed from the currents. A reading outside its
        calibrated range is NaN. ``supply_voltages``, ``temperatures``: (n,) [V], [K]; None: at the reference of each
        probe. ``lit_sources``: (n, d); None: for each diode the source that is nearest to its middle.
        """
        unknown = np.full(len(rotations), np.nan)
        supplies = unknown if supply_voltages is None else supply_voltages
        warmth = unknown if temperatures is None else temperatures
        fields: dict[str, NDArray[Any]] = {}
        for sensor in self._sensors:
            fields |= sensor.readings(rotations, translations, _Surroundings(supplies, warmth, lit_sources))
        return fields

    def spot_currents(self, diode: int, spots: FloatArray) -> FloatArray:
        """Return the contact currents (n, 4) [A] of a diode with its light at spots (n, 2) [m]."""
        diodes = next(sensor for sensor in self._sensors if isinstance(sensor, _Diodes))
        return diodes.spot_currents(diode, spots)


class _Surroundings(NamedTuple):
    """Conditions of n scans; see ``TrueJoint.readings``."""

    supplies: FloatArray  # NaN: at the reference
    temperatures: FloatArray
    lit_sources: NDArray[np.int64] | None


class _Sensor(ABC):
    """One sensor: named arrays of its parameters, and what follows from them."""

    TYPE: str  # in the file

    def __init__(self, entry: Mapping[str, Any], replaced: Mapping[str, Any]) -> None:
        self._entry, self._replaced = entry, replaced
        self._values = self._read()
        self._prepare()

    @abstractmethod
    def _read(self) -> dict[str, FloatArray]:
        """Return the parameters of the file."""

    @abstractmethod
    def _prepare(self) -> None:
        """Compute what follows from the parameters."""

    @abstractmethod
    def readings(
        self, rotations: FloatArray, translations: FloatArray, surroundings: _Surroundings
    ) -> dict[str, NDArray[Any]]:
        """Return the raw readings, see ``TrueJoint.readings``."""

    def with_errors(self, errors: Mapping[tuple[str, tuple[int, ...]], float]) -> Self:
        """Return the sensor with other parameters."""
        other, values = copy.copy(self), {name: value.copy() for name, value in self._values.items()}
        for (name, index), error in errors.items():
            values[name][index] += error
        other._values = values  # noqa: SLF001  a copy of the same class
        other._prepare()  # noqa: SLF001
        return other


class _Probes(_Sensor):
    """Probes of any surface."""

    FIELD: str

    def _read(self) -> dict[str, FloatArray]:
        probes = self._entry["probes"]
        longest = max(len(probe["volts_to_gap"]["value"]) for probe in probes)

        def pair(probe: Mapping[str, Any], name: str, unit: str) -> list[float]:
            part = probe.get(name)
            if part is None:
                return [0.0, 0.0]
            return [float(si_values(part["sensitivity"], f"m/{unit}")), float(si_values(part["reference"], unit))]

        def curve(probe: Mapping[str, Any]) -> FloatArray:
            coefficients = si_values(probe["volts_to_gap"], "m/V^k")
            return np.append(coefficients, np.zeros(longest - len(coefficients)))

        return {
            "tips": np.array([si_values(probe["tip"], "m") for probe in probes]),
            "axes": np.array([si_values(probe["axis"], "1") for probe in probes]),
            "volts_to_gap": np.array([curve(probe) for probe in probes]),
            "zero_shifts": np.array([float(si_values(probe["zero_shift"], "V")) for probe in probes]),
            "supply": np.array([pair(probe, "supply", "V") for probe in probes]),
            "temperature": np.array([pair(probe, "temperature", "K") for probe in probes]),
        }

    def _prepare(self) -> None:
        names = ("volts_to_gap", "zero_shifts", "supply", "temperature")
        self._curves = [
            ProbeCurve(si_values(probe["range"], "V"), *(self._values[name][i] for name in names))
            for i, probe in enumerate(self._entry["probes"])
        ]

    @abstractmethod
    def _distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return the distances that the probes measure, (n, p) [m]."""

    def readings(
        self, rotations: FloatArray, translations: FloatArray, surroundings: _Surroundings
    ) -> dict[str, NDArray[Any]]:
        gaps = self._distances(rotations, translations)
        supplies, temperatures, _ = surroundings
        volts = [c.voltages(each, supplies, temperatures) for c, each in zip(self._curves, gaps.T, strict=True)]
        return {self.FIELD: np.column_stack(volts)}


class _GapProbes(_Probes):
    """Probes of the target plane."""

    TYPE, FIELD = "gap_probes", "gap_voltages"

    def _read(self) -> dict[str, FloatArray]:
        values, plane = super()._read(), self._entry["target_plane"]
        if self._replaced.get("zero_shifts") is not None:
            values["zero_shifts"] = si_values(self._replaced["zero_shifts"], "V")
        return values | {"plane_point": si_values(plane["point"], "m"), "plane_tilt": si_values(plane["tilt"], "rad")}

    def _prepare(self) -> None:
        super()._prepare()
        self._plane = ProbedPlane(*(self._values[name] for name in ("tips", "axes", "plane_point", "plane_tilt")))

    def readings(
        self, rotations: FloatArray, translations: FloatArray, surroundings: _Surroundings
    ) -> dict[str, NDArray[Any]]:
        fields = super().readings(rotations, translations, surroundings)
        if (known := self._entry.get("reference")) is None:
            return fields
        return fields | {"reference_voltages": np.full(len(rotations), float(si_values(known["voltage"], "V")))}

    def _distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        return self._plane.distances(rotations, translations)


class _BumpyRing(_Probes):
    """Probes of the bumpy ring."""

    TYPE, FIELD = "bumpy_ring", "ring_voltages"

    def _read(self) -> dict[str, FloatArray]:
        ring = self._entry["ring"]
        return super()._read() | {name: si_values(ring[name], "m") for name in ("mean_radius", "cos", "sin")}

    def _prepare(self) -> None:
        super()._prepare()
        radius, orders = float(self._values["mean_radius"]), np.array(self._entry["ring"]["orders"])
        self._profile = RingProfile(radius, orders, self._values["cos"], self._values["sin"])

    def _distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        return ring_distances(rotations, translations, self._values["tips"], self._values["axes"], self._profile)


def _sum_of(diode: Mapping[str, Any], name: str) -> float:
    """Return a limit of the sum of two contacts [A]; infinite without an entry."""
    return float(si_values(diode[name], "A")) if diode.get(name) else np.inf


class _Diodes(_Sensor):
    """Diodes and their light sources. ``maps`` holds the errors of the maps alone, in the order of their parameters."""

    TYPE = "diodes"

    def _read(self) -> dict[str, FloatArray]:
        diodes, sources = self._entry["diodes"], self._entry["light_sources"]
        self._map_entries = self._entry["maps"][self._replaced.get("diode_map") or self._entry["map"]]
        self._sums = [(_sum_of(each, "minimum_sum"), _sum_of(each, "maximum_sum")) for each in diodes]

        def of(entries: list[dict[str, Any]], name: str, unit: str) -> FloatArray:
            return np.array([si_values(each[name], unit) for each in entries])

        return {
            "origins": of(diodes, "origin", "m"),
            "x_axes": of(diodes, "x_axis", "1"),
            "y_axes": of(diodes, "y_axis", "1"),
            "maps": np.zeros((len(diodes), _MOST_PARAMETERS)),
            "source_origins": of(sources, "origin", "m"),
            "source_directions": of(sources, "direction", "1"),
        }

    def _prepare(self) -> None:
        values = self._values
        diodes = zip(values["origins"], values["x_axes"], values["y_axes"], strict=True)
        self._planes = [DiodePlane(*diode) for diode in diodes]
        self._maps = [read_map(each, wrong) for each, wrong in zip(self._map_entries, values["maps"], strict=True)]
        self._middles = [each.positions(np.mean(each.domain, axis=1)[None])[0] for each in self._maps]

    def readings(
        self, rotations: FloatArray, translations: FloatArray, surroundings: _Surroundings
    ) -> dict[str, NDArray[Any]]:
        sources = self._values["source_origins"], self._values["source_directions"]
        currents, lit, given = [], [], surroundings.lit_sources
        for i, (plane, middle) in enumerate(zip(self._planes, self._middles, strict=True)):
            spots = plane.hits(rotations, translations, *sources)
            lit.append(nearest_sources(spots, middle) if given is None else given[:, i])
            currents.append(self.spot_currents(i, spots[np.arange(len(spots)), lit[-1]]))
        fields: dict[str, NDArray[Any]] = {
            "diode_currents": np.stack(currents, axis=1),
            "lit_sources": np.stack(lit, axis=1),
        }
        if self._entry.get("ambient") is not None:  # there is no ambient light here
            fields["statuses"] = np.full(len(rotations), DARK_SUBTRACTED)
        return fields

    def spot_currents(self, diode: int, spots: FloatArray) -> FloatArray:
        """Return the contact currents of one diode, see ``TrueJoint.spot_currents``."""
        ratios = self._maps[diode].ratios(spots)
        return contact_currents(ratios, self._maps[diode].domain, self._sums[diode])


_SENSORS: Mapping[str, type[_Sensor]] = {"GapProbes": _GapProbes, "BumpyRing": _BumpyRing, "Diodes": _Diodes}
"""Kinds of sensors by the first part of the name of an error."""

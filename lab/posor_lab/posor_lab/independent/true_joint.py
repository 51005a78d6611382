"""Raw readings of one joint by its calibration file, for many poses of its target plate."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from posor_lab.independent.diode_contacts import contact_currents, read_map
from posor_lab.independent.file_values import si_values
from posor_lab.independent.light_rays import DiodePlane, nearest_sources
from posor_lab.independent.probe_curve import ProbeCurve
from posor_lab.independent.probe_distance import RingProfile, plane_distances, ring_distances

if TYPE_CHECKING:
    from collections.abc import Mapping

FloatArray = NDArray[np.float64]

_ERROR_NAME = re.compile(r"(\w+)\.(\w+)\[([\d,]*)\]")
_MOST_PARAMETERS = 2 * 32 * 32
"""Of the map of a diode."""
_SECTIONS = {"GapProbes": "gap_probes", "BumpyRing": "bumpy_ring", "Diodes": "diodes"}
"""Types of sensors in the file, by the first part of the name of an error."""


class TrueJoint:
    """A POSOR as it is: its calibration file, and how the real parts differ from it."""

    def __init__(
        self, content: Mapping[str, Any], session: str = "", errors: Mapping[str, float] | None = None
    ) -> None:
        """Read the sensors.

        ``content``: of the calibration file; ``session``: its applied session; ``errors``: real value minus that of
        the file [SI], by names such as ``GapProbes.tips[0,2]``.

        Raises ValueError: the file has another unit, or a kind of sensor or of tilt that this model does not know.
        """
        if content.get("tilt_angle", "this_scan") != "this_scan":
            what = "the tilt of the previous scan is a habit of 1985, no geometry; expected 'this_scan'"
            raise ValueError(what)
        replaced = content["sessions"][session] if session else {}
        by_section: dict[str, dict[tuple[str, tuple[int, ...]], float]] = {name: {} for name in _SECTIONS.values()}
        for name, error in (errors or {}).items():
            match = _ERROR_NAME.fullmatch(name)
            if match is None or match[1] not in _SECTIONS:
                what = f"error of '{name}'; expected a name such as GapProbes.tips[0,2]"
                raise ValueError(what)
            index = tuple(int(each) for each in match[3].split(",") if each)
            by_section[_SECTIONS[match[1]]][match[2], index] = error
        self._sensors: list[_Probes | _Diodes] = []
        for entry in content["sensors"]:
            kind = entry["type"]
            if kind not in by_section:
                what = f"sensor of type '{kind}'; expected one of {', '.join(by_section)}"
                raise ValueError(what)
            sensor = _Diodes if kind == "diodes" else _GapProbes if kind == "gap_probes" else _RingProbes
            self._sensors.append(sensor(entry, replaced, by_section[kind]))

    def readings(
        self,
        rotations: FloatArray,
        translations: FloatArray,
        supply_voltages: FloatArray | None = None,
        temperatures: FloatArray | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return the raw readings at poses of the target in the receiving plate, (n, 3, 3), (n, 3) [m], by field.

        Fields: ``gap_voltages``, ``ring_voltages`` (n, p) [V], ``diode_currents`` (n, d, 4) [A], ``lit_sources``
        (n, d). A reading outside its calibrated range is NaN. ``supply_voltages``, ``temperatures``: (n,) [V], [K];
        None: at the reference of each probe.
        """
        unknown = np.full(len(rotations), np.nan)
        supplies = unknown if supply_voltages is None else supply_voltages
        warmth = unknown if temperatures is None else temperatures
        fields: dict[str, NDArray[Any]] = {}
        for sensor in self._sensors:
            fields |= sensor.readings(rotations, translations, supplies, warmth)
        return fields


def _add_errors(values: dict[str, FloatArray], errors: Mapping[tuple[str, tuple[int, ...]], float]) -> None:
    """Add errors to named arrays."""
    for (name, index), error in errors.items():
        if error:  # a padded coefficient does not exist, and has no error
            values[name][index] += error


class _Probes:
    """Probes of any surface."""

    FIELD = ""

    def __init__(
        self, entry: Mapping[str, Any], replaced: Mapping[str, Any], errors: Mapping[tuple[str, tuple[int, ...]], float]
    ) -> None:
        probes = entry["probes"]
        longest = max(len(probe["volts_to_gap"]["value"]) for probe in probes)

        def pair(probe: Mapping[str, Any], name: str, unit: str) -> list[float]:
            part = probe.get(name)
            if part is None:
                return [0.0, 0.0]
            sensitivity, reference = si_values(part["sensitivity"], f"m/{unit}"), si_values(part["reference"], unit)
            return [float(sensitivity), float(reference)]

        def curve(probe: Mapping[str, Any]) -> FloatArray:
            coefficients = si_values(probe["volts_to_gap"], "m/V^k")
            return np.append(coefficients, np.zeros(longest - len(coefficients)))

        values = {
            "tips": np.array([si_values(probe["tip"], "m") for probe in probes]),
            "axes": np.array([si_values(probe["axis"], "1") for probe in probes]),
            "volts_to_gap": np.array([curve(probe) for probe in probes]),
            "zero_shifts": np.array([float(si_values(probe["zero_shift"], "V")) for probe in probes]),
            "supply": np.array([pair(probe, "supply", "V") for probe in probes]),
            "temperature": np.array([pair(probe, "temperature", "K") for probe in probes]),
            **self._surface(entry),
        }
        if self.FIELD == "gap_voltages" and replaced.get("zero_shifts") is not None:
            values["zero_shifts"] = si_values(replaced["zero_shifts"], "V")
        _add_errors(values, errors)
        self._values = values
        spans = [si_values(probe["range"], "V") for probe in probes]
        self._curves = [
            ProbeCurve(values["volts_to_gap"][i], values["zero_shifts"][i], span, values["supply"][i], temperature)
            for i, (span, temperature) in enumerate(zip(spans, values["temperature"], strict=True))
        ]

    def _surface(self, entry: Mapping[str, Any]) -> dict[str, FloatArray]:
        raise NotImplementedError

    def _distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        raise NotImplementedError

    def readings(
        self, rotations: FloatArray, translations: FloatArray, supplies: FloatArray, temperatures: FloatArray
    ) -> dict[str, NDArray[Any]]:
        """Return the voltages, see ``TrueJoint.readings``."""
        gaps = self._distances(rotations, translations)
        volts = [c.voltages(each, supplies, temperatures) for c, each in zip(self._curves, gaps.T, strict=True)]
        return {self.FIELD: np.column_stack(volts)}


class _GapProbes(_Probes):
    """Probes of the target plane."""

    FIELD = "gap_voltages"

    def _surface(self, entry: Mapping[str, Any]) -> dict[str, FloatArray]:
        plane = entry["target_plane"]
        return {"plane_point": si_values(plane["point"], "m"), "plane_tilt": si_values(plane["tilt"], "rad")}

    def _distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        names = ("tips", "axes", "plane_point", "plane_tilt")
        return plane_distances(rotations, translations, *(self._values[name] for name in names))


class _RingProbes(_Probes):
    """Probes of the bumpy ring."""

    FIELD = "ring_voltages"
    _profile: RingProfile | None = None

    def _surface(self, entry: Mapping[str, Any]) -> dict[str, FloatArray]:
        ring = entry["ring"]
        self._orders = np.array(ring["orders"], dtype=float)
        return {name: si_values(ring[name], "m") for name in ("mean_radius", "cos", "sin")}

    def _distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        values = self._values
        if self._profile is None:
            radius = float(values["mean_radius"])
            self._profile = RingProfile(radius, self._orders, values["cos"], values["sin"])
        return ring_distances(rotations, translations, values["tips"], values["axes"], self._profile)


def _sum_of(diode: Mapping[str, Any], name: str) -> float:
    """Return a limit of the sum of two contacts [A]; infinite without an entry."""
    return float(si_values(diode[name], "A")) if diode.get(name) else np.inf


class _Diodes:
    """Diodes and their light sources."""

    def __init__(
        self, entry: Mapping[str, Any], replaced: Mapping[str, Any], errors: Mapping[tuple[str, tuple[int, ...]], float]
    ) -> None:
        diodes, sources = entry["diodes"], entry["light_sources"]
        maps = entry["maps"][replaced.get("diode_map") or entry["map"]]

        def of(entries: list[dict[str, Any]], name: str, unit: str) -> FloatArray:
            return np.array([si_values(each[name], unit) for each in entries])

        values = {
            "origins": of(diodes, "origin", "m"),
            "x_axes": of(diodes, "x_axis", "1"),
            "y_axes": of(diodes, "y_axis", "1"),
            "maps": np.zeros((len(maps), _MOST_PARAMETERS)),
            "source_origins": of(sources, "origin", "m"),
            "source_directions": of(sources, "direction", "1"),
        }
        _add_errors(values, errors)
        self._sources = values["source_origins"], values["source_directions"]
        self._planes = [
            DiodePlane(*(values[name][i] for name in ("origins", "x_axes", "y_axes"))) for i in range(len(maps))
        ]
        self._maps = [read_map(each, wrong) for each, wrong in zip(maps, values["maps"], strict=True)]
        self._middles = [each.positions(np.mean(each.domain, axis=1)[None])[0] for each in self._maps]
        self._sums = [(_sum_of(each, "minimum_sum"), _sum_of(each, "maximum_sum")) for each in diodes]

    def readings(
        self, rotations: FloatArray, translations: FloatArray, _supplies: FloatArray, _temperatures: FloatArray
    ) -> dict[str, NDArray[Any]]:
        """Return currents and lit sources, see ``TrueJoint.readings``."""
        currents, lit = [], []
        for plane, diode_map, middle, sums in zip(self._planes, self._maps, self._middles, self._sums, strict=True):
            spots = plane.hits(rotations, translations, *self._sources)
            lit.append(nearest_sources(spots, middle))
            ratios = diode_map.ratios(spots[np.arange(len(spots)), lit[-1]])
            currents.append(contact_currents(ratios, diode_map.domain, sums))
        return {"diode_currents": np.stack(currents, axis=1), "lit_sources": np.stack(lit, axis=1)}

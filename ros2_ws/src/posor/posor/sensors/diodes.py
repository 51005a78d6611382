# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lateral effect diodes: two-dimensional position sensing diodes that see light sources on the target plate.

Two fixed sources serve a large rotation as wide as the diodes; many sources on a ring, lit one after another, extend it
to full turns: the scan names the source that each diode sees, and the diode is handed over from one to the next.

Source: thesis 5.4.1; diode offsets 7.4.4 (equations 7.2-7.4); light-source inclination, table 7.8.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.plausible_range import PLACE
from posor.calibration.quantity import Quantity, check_positive, check_unit_vector, measured
from posor.errors import CalibrationError, ScanError
from posor.model import diode as codes
from posor.model.diode import DIODE, SPOT_POSITION
from posor.model.fault import Fault
from posor.model.reading_rows import ROW, SPOT_X, evaluate_poses
from posor.model.readings import DIODE_CURRENTS, WRONG_COUNT, WRONG_SOURCE, WRONG_SOURCES, fault_of_code
from posor.model.scan import DARK_SUBTRACTED, NO_SOURCE
from posor.model.spot_map import CURVES, position_of_ratios, ratios_of_positions
from posor.numerics.compiled import record_view
from posor.sensors.base import ReadingSource, RowSensor, SensorCalibration, no_parameters
from posor.sensors.diode_map import SpotMap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.calibration.session import Session
    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import FloatArray, IntArray


CONTACT_LETTERS = "ABCD"  # of a diode, in the order of its currents


class DiodeCalibration(FrozenModel):
    """One diode on the receiving plate R: its plane and axes, its noise, and what counts as light.

    ``noise`` is the standard deviation of the two averaged ratios; ``minimum_sum`` is the least current A + C, and B +
    D, that one lit source gives, ``maximum_sum`` the greatest: more means that two sources are lit.
    """

    name: str
    origin: Annotated[Quantity, measured("m", 3)]
    x_axis: Annotated[Quantity, measured("1", 3)]
    y_axis: Annotated[Quantity, measured("1", 3)]
    noise: Annotated[Quantity, measured("1", 2)]
    minimum_sum: Annotated[Quantity, measured("A")]
    maximum_sum: Annotated[Quantity, measured("A")] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        PLACE.check("origin", self.origin)
        check_unit_vector("x_axis", self.x_axis)
        check_unit_vector("y_axis", self.y_axis)
        sine = float(np.linalg.norm(np.cross(self.x_axis.array, self.y_axis.array)))
        if sine < 0.5:  # noqa: PLR2004
            what = f"x_axis and y_axis are nearly parallel (sine {sine:.3g})"
            raise EntryError(what, key=("x_axis",), expected="axes near a right angle")
        if not np.all(self.noise.array > 0.0):
            raise EntryError(f"noise {self.noise.value}", key=("noise",), expected="more than 0")
        least, greatest = self.sums
        if not least > 0.0:
            raise EntryError(f"minimum_sum {least:g} A", key=("minimum_sum",), expected="more than 0 A")
        if not greatest > least:
            expected = f"more than minimum_sum, {least:g} A"
            raise EntryError(f"maximum_sum {greatest:g} A", key=("maximum_sum",), expected=expected)
        return self

    @property
    def sums(self) -> tuple[float, float]:
        """Least and greatest current sum [A]."""
        return self.minimum_sum.number, math.inf if self.maximum_sum is None else self.maximum_sum.number


class LightSourceCalibration(FrozenModel):
    """One light source on the target plate T: where its ray starts and where it goes."""

    name: str
    origin: Annotated[Quantity, measured("m", 3)]
    direction: Annotated[Quantity, measured("1", 3)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        PLACE.check("origin", self.origin)
        check_unit_vector("direction", self.direction)
        return self


class AmbientLight(FrozenModel):
    """How ambient light is removed from the diode currents: by dark scans, or by a device that demodulates.

    A scan flagged STATUS_DARK_SUBTRACTED holds no ambient light. Any other needs a dark scan, in which no source is
    lit, at most ``max_age`` ago. ``noise`` is the standard deviation of a contact's current in a dark scan; ``drift``
    that of the change of the ambient light within a second (it grows with the root of time); ``remaining`` the largest
    ambient current that is left, as a share of ``minimum_sum``; ``source_light`` the standard uncertainty of the share
    of the sources' light that is still in a dark scan (missing: zero).
    """

    noise: Annotated[Quantity, measured("A")]
    drift: Annotated[Quantity, measured("A/s^0.5")]
    max_age: Annotated[Quantity, measured("s")]
    remaining: Annotated[Quantity, measured("1")]
    source_light: Annotated[Quantity, measured("1")] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_positive("noise", self.noise)
        check_positive("drift", self.drift, or_zero=True)
        check_positive("max_age", self.max_age)
        check_positive("remaining", self.remaining, below=1.0)
        if self.source_light is not None:
            check_positive("source_light", self.source_light, below=1.0)
        return self


CONTRADICTION = 10.0
"""Standard deviations by which the distance of two spots must contradict light sources that have slipped."""


def slip_angle(diodes: FloatArray, sources: FloatArray, sigma: float) -> float:
    """Return the smallest angle by which theta may be wrong, unseen, if the numbers of all lit sources slip alike.

    The spots on two diodes show the distance of the two sources. A slip by k sources is seen if the distance of every
    pair of sources that two diodes can see at a time differs from that of the pair k further by more than CONTRADICTION
    standard deviations. One fixed source for each diode cannot slip.

    ``diodes``: origins in the plane of R [m], shape (d, 2). ``sources``: origins in the plane of T [m], in the order of
    their numbers around the ring, shape (n, 2). ``sigma``: standard uncertainty of the distance of two spots [m]. The
    result is in [rad]; zero: every slip is seen.
    """
    count = len(sources)
    if count <= len(diodes):
        return 0.0
    azimuths = np.arctan2(sources[:, 1], sources[:, 0])
    distances = np.linalg.norm(sources[:, None] - sources[None, :], axis=2)
    one, other = np.tril_indices(len(diodes), -1)
    seen = _nearest_sources(diodes, sources)
    seen_distances = distances[seen[:, one], seen[:, other]]
    smallest = math.inf
    for slip in range(1, count):
        slipped = (seen + slip) % count
        differences = np.abs(distances[slipped[:, one], slipped[:, other]] - seen_distances)
        if not np.all(np.max(differences, axis=1, initial=0.0) > CONTRADICTION * sigma):
            angles = np.abs(np.mod(np.roll(azimuths, -slip) - azimuths + math.pi, 2.0 * math.pi) - math.pi)
            smallest = min(smallest, float(np.min(angles)))
    return smallest if smallest < math.inf else 0.0


def _nearest_sources(diodes: FloatArray, sources: FloatArray) -> IntArray:
    """Return the source nearest to each diode at 16 thetas for each source, around a turn, shape (thetas, d)."""
    thetas = np.linspace(0.0, 2.0 * math.pi, 16 * len(sources), endpoint=False)
    c, s = np.cos(thetas)[:, None], np.sin(thetas)[:, None]
    x, y = c * sources[:, 0] - s * sources[:, 1], s * sources[:, 0] + c * sources[:, 1]  # (thetas, n)
    squares = np.square(x - diodes[:, :1, None]) + np.square(y - diodes[:, 1:, None])  # (d, thetas, n)
    nearest: IntArray = np.argmin(squares, axis=2).T
    return nearest


class DiodesCalibration(SensorCalibration):
    """Diodes, the sources they see, and named sets of maps (one map for each diode in each set).

    ``ambient``: how ambient light is removed; missing: the currents are used as they are.
    """

    type: Literal["diodes"]
    diodes: Annotated[list[DiodeCalibration], Field(min_length=1, max_length=4)]
    light_sources: Annotated[list[LightSourceCalibration], Field(min_length=1, max_length=NO_SOURCE)]
    map: str
    maps: dict[str, list[SpotMap]]
    ambient: AmbientLight | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, maps in self.maps.items():
            if len(maps) != len(self.diodes):
                expected = f"{len(self.diodes)}, one for each diode"
                raise EntryError(f"maps.{name} has {len(maps)} maps", key=("maps", name), expected=expected)
        if self.map not in self.maps:
            raise EntryError(f"map '{self.map}'", key=("map",), expected=f"one of {', '.join(self.maps)}")
        return self

    @property
    def slip_angle(self) -> float:
        """See the function ``slip_angle``."""
        diodes = np.array([diode.origin.array[:2] for diode in self.diodes])
        sources = np.array([source.origin.array[:2] for source in self.light_sources])
        origins = np.array([np.max(diode.origin.sigmas[:2]) for diode in self.diodes])
        variances = self.build().spot_variances() + np.square(origins)
        # The sources of the pair seen and those of the pair assumed are different ones.
        of_source = 2.0 * max(float(np.max(source.origin.sigmas[:2] ** 2)) for source in self.light_sources)
        return slip_angle(diodes, sources, math.sqrt(2.0 * (float(np.max(variances)) + of_source)))

    def build(self) -> Diodes:
        """Return the sensor."""
        return Diodes(self)

    def for_session(self, session: Session) -> Self:
        """Return the calibration with the session's set of maps.

        Raises CalibrationError: there is no set of that name.
        """
        if session.diode_map is None:
            return self
        if session.diode_map not in self.maps:
            expected = f"one of {', '.join(self.maps)}"
            raise CalibrationError(f"'{session.diode_map}'", where="diode_map of the session", expected=expected)
        return self.model_copy(update={"map": session.diode_map})


class Diodes(RowSensor):
    """Diodes with their maps; two rows, x and y, for each diode and each source that it may see."""

    def __init__(self, calibration: DiodesCalibration) -> None:
        """Take the parameters out of a validated calibration."""
        diodes, sources, maps = calibration.diodes, calibration.light_sources, calibration.maps[calibration.map]
        self._names = tuple(diode.name for diode in diodes)
        self._sources, self._ambient = len(sources), calibration.ambient
        self._diodes = np.zeros(len(diodes), dtype=DIODE)
        for record, diode, spot_map in zip(self._diodes, diodes, maps, strict=True):
            record["least_sum"], record["greatest_sum"] = diode.sums
            record["noise"], record["domain"] = diode.noise.array, spot_map.domain.array
            record["center"], record["scale"] = spot_map.center_and_scale
            record["map_kind"], record["map_lengths"] = spot_map.map_kind, spot_map.map_lengths
        longest = max(m.parameters[0].size for m in maps)

        def of(attribute: str) -> dict[str, FloatArray]:
            tables = [m.parameters[attribute == "sigmas"] for m in maps]
            return {
                "origins": np.array([getattr(d.origin, attribute) for d in diodes]),
                "x_axes": np.array([getattr(d.x_axis, attribute) for d in diodes]),
                "y_axes": np.array([getattr(d.y_axis, attribute) for d in diodes]),
                "maps": np.array([np.pad(table, (0, longest - table.size)) for table in tables]),
                "source_origins": np.array([getattr(s.origin, attribute) for s in sources]),
                "source_directions": np.array([getattr(s.direction, attribute) for s in sources]),
            }

        super().__init__(of("array"), of("sigmas"))

    def _prepare(self) -> None:
        super()._prepare()
        self._first_pairs = np.arange(len(self._names)) * self._sources

    def _layout(self) -> tuple[NDArray[np.void], IntArray]:
        # Row 2 (diode * sources + source) + axis.
        count = 2 * len(self._names) * self._sources
        pair, axis = np.divmod(np.arange(count), 2)
        diode, source = np.divmod(pair, self._sources)
        rows, of_row = np.zeros(count, dtype=ROW), no_parameters(count)
        rows["kind"] = SPOT_X + axis
        for name, parameter, which in (
            ("diode_origin", "origins", diode),
            ("x_axis", "x_axes", diode),
            ("y_axis", "y_axes", diode),
            ("source_origin", "source_origins", source),
            ("ray_direction", "source_directions", source),
        ):
            of_row[name] = self.parameter_ids(parameter)[which]
        return rows, of_row["parameters"]

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``spot x <diode>``, ``spot y <diode>`` for each diode."""
        return tuple(f"spot {axis} {name}" for name in self._names for axis in "xy")

    @property
    def reading_source(self) -> ReadingSource:
        """The contact currents, and each map's parameters for x and for y."""
        ids = np.repeat(self.parameter_ids("maps"), 2, axis=0)
        for i, diode in enumerate(self._diodes):
            if diode["map_kind"] != CURVES:  # each coordinate has a table of its own
                size = int(np.prod(diode["map_lengths"]))
                ids[2 * i, size:], ids[2 * i + 1, :size] = -1, -1
        return ReadingSource(
            DIODE_CURRENTS, ids, diodes=self._diodes, map_parameters=self._array("maps"), light_sources=self._sources
        )

    def _rows_of(self, lit: IntArray) -> IntArray:
        """Return the reading rows for lit sources (n, diodes), shape (n, 2 diodes)."""
        rows = np.empty((len(lit), 2 * len(self._names)), dtype=np.int64)
        rows[:, 0::2] = 2 * (self._first_pairs + lit)
        rows[:, 1::2] = rows[:, 0::2] + 1
        return rows

    def selected_rows(self, scan: Scan) -> IntArray:
        """Return the rows of the light sources lit."""
        rows: IntArray = self._rows_of(np.array([scan.lit_sources], dtype=np.int64))[0]
        return rows

    def explain(self, scan: Scan, code: int) -> ScanError:
        """Return what a code of the contact currents means."""
        where = f"scan {scan.number}"
        count, fault = len(self._names), Fault(fault_of_code(DIODE_CURRENTS, code))
        if code == WRONG_COUNT:
            what, expected = f"{scan.diode_currents.size} contact currents", f"{4 * count}"
        elif code == WRONG_SOURCES:
            what, expected = f"{len(scan.lit_sources)} lit sources", f"{count}, one for each diode"
        elif code <= WRONG_SOURCE:
            diode = WRONG_SOURCE - code
            lit = scan.lit_sources[diode]
            where = f"{where}, diode {self._names[diode]}"
            what = "no light source was lit" if lit == NO_SOURCE else f"light source {lit} is unknown"
            expected = f"a source from 0 to {self._sources - 1}"
        else:
            diode, what_code = divmod(code, codes.CODES)
            where = f"{where}, diode {self._names[diode]}"
            what, expected = self._explain_currents(scan, diode, what_code)
        return ScanError(what, fault=fault, where=where, expected=expected)

    def _explain_currents(self, scan: Scan, diode: int, code: int) -> tuple[str, str]:
        """Return what is wrong with the contact currents of a diode, and what is expected."""
        (a, b, c, d), lit = scan.diode_currents[diode].tolist(), scan.lit_sources[diode]
        least, greatest = self._diodes[diode][["least_sum", "greatest_sum"]].tolist()
        sums = f"A + C = {a + c:.3g} A, B + D = {b + d:.3g} A"
        if code == codes.NOT_FINITE:
            return f"contact currents {a}, {b}, {c}, {d}", "finite currents"
        if code == codes.DARK:
            return f"too dark, {sums}", f"at least {least:.3g} A"
        if code == codes.BRIGHT:
            if lit == NO_SOURCE:
                return f"light in a dark scan, {sums}", f"less than {least:.3g} A"
            return f"too bright for one light source, {sums}", f"at most {greatest:.3g} A"
        axis = code - codes.OUTSIDE_X
        ratio = ((a - c) / (a + c), (b - d) / (b + d))[axis]
        low, high = self._diodes["domain"][diode, axis]
        return f"{'xy'[axis]} ratio {ratio:.6g} is outside the calibrated map", f"{low:g} to {high:g}"

    def encode(self, readings: FloatArray, scans: Scans) -> dict[str, FloatArray]:
        """Return the contact currents of spot positions, their sums in the middle of the diode's range.

        They hold no ambient light: where the calibration removes it, the scans are flagged so.
        """
        currents = np.empty((len(readings), len(self._names), 4))
        for i, parameters in enumerate(self._array("maps")):
            spots = np.zeros(len(readings), dtype=SPOT_POSITION)
            positions = np.ascontiguousarray(readings[:, 2 * i : 2 * i + 2])
            diodes, work = self._diodes[i : i + 1], np.empty((2, parameters.size))
            ratios_of_positions(
                record_view(diodes), np.ascontiguousarray(parameters), positions, record_view(spots), work
            )
            least, greatest = float(diodes["least_sum"][0]), float(diodes["greatest_sum"][0])
            total = 0.5 * (least + greatest) if math.isfinite(greatest) else 2.0 * least
            currents[:, i, :2] = 0.5 * total * (1.0 + spots["ratios"])
            currents[:, i, 2:] = 0.5 * total * (1.0 - spots["ratios"])
        fields: dict[str, Any] = {"diode_currents": currents}
        return fields if self._ambient is None else fields | {"statuses": scans.statuses | DARK_SUBTRACTED}

    def disturbed(self, scans: Scans, noise: np.random.Generator) -> dict[str, FloatArray]:
        """Return the currents with the ratios' noise, their sums unchanged."""
        currents = scans.diode_currents
        totals = currents[:, :, :2] + currents[:, :, 2:]
        shifts = 0.5 * totals * noise.normal(size=totals.shape) * self._diodes["noise"]
        return {"diode_currents": np.concatenate([currents[:, :, :2] + shifts, currents[:, :, 2:] - shifts], axis=2)}

    def rows_at(self, rotations: FloatArray, translations: FloatArray) -> tuple[IntArray, dict[str, IntArray]]:
        """Light, for each diode, the source whose spot is nearest to the middle of the diode's map."""
        count = len(rotations)
        lit = np.empty((count, len(self._names)), dtype=np.int64)
        for i in range(len(self._names)):
            middle, _ = self._map(i, self._diodes["domain"][i].mean(axis=1))
            rows = 2 * (i * self._sources + np.arange(self._sources))
            every = np.tile(np.column_stack([rows, rows + 1]).ravel(), (count, 1))
            spots = evaluate_poses(self.rows, every, rotations, translations)
            distances = spots.reshape(count, self._sources, 2) - middle
            lit[:, i] = np.argmin(np.sum(np.square(distances), axis=2), axis=1)
        return self._rows_of(lit), {"lit_sources": lit}

    def _linearisation_jacobian(self, scan: Scan) -> FloatArray:
        out = np.zeros((2 * len(self._names), self._values.size))
        for i, ids in enumerate(self.parameter_ids("maps")):
            a, b, c, d = scan.diode_currents[i]
            out[2 * i : 2 * i + 2, ids] = self._map(i, np.array([(a - c) / (a + c), (b - d) / (b + d)]))[1]
        return out

    def spot_variances(self) -> FloatArray:
        """Return the variance of a spot's position from noise and map in the middle of each diode, (diodes,) [m^2]."""
        variances = np.empty(len(self._names))
        sigmas = self._sigmas[self._slices["maps"]].reshape(len(self._names), -1)
        for i, diode in enumerate(self._diodes):
            low, high = diode["domain"].T
            middle, by_parameters = self._map(i, 0.5 * (low + high))
            slope = np.abs(self._map(i, 0.5 * (low + high) + diode["noise"])[0] - middle)
            variances[i] = np.max(np.square(slope)) + np.max(np.square(by_parameters) @ np.square(sigmas[i]))
        return variances

    def _map(self, i: int, ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the spot's position on diode i (2,) [m] and its derivatives by the parameters of the map, (2, p)."""
        parameters, spots = np.ascontiguousarray(self._array("maps")[i]), np.zeros(1, dtype=SPOT_POSITION)
        derivatives = np.zeros((2, parameters.size))
        spots["ratios"][0] = ratios
        position_of_ratios(record_view(self._diodes[i : i + 1]), parameters, record_view(spots), derivatives)
        return spots["position"][0], -derivatives

"""Lateral effect diodes: two-dimensional position sensing diodes that see light sources on the target plate.

Source: thesis 5.3.2; diode offsets 7.4.4 (equations 7.2-7.4); light-source inclination, table 7.8.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from posor_estimator.core.calibration.quantity import FrozenModel, Quantity, measured
from posor_estimator.core.fault import Fault
from posor_estimator.core.kernels import spot as kernel
from posor_estimator.core.kernels.solve import SPOT_X, SPOT_Y
from posor_estimator.core.scan import NO_SOURCE
from posor_estimator.core.sensors.base import ROW_WIDTH, Linearised, Sensor, SensorCalibration
from posor_estimator.core.sensors.spot_map import SpotMapCalibration, position, powers, slope
from posor_estimator.errors import CalibrationError, ScanError

if TYPE_CHECKING:
    from posor_estimator.core.calibration.session import Session
    from posor_estimator.core.scan import Scan
    from posor_estimator.core.types import FloatArray, IntArray


class DiodeCalibration(FrozenModel):
    """One diode on the receiving plate R: its plane and axes, its noise, and what counts as light.

    ``noise`` is the standard deviation of the two ratios; ``minimum_sum`` is the least current A + C, and B + D, that
    a lit source gives.
    """

    name: str
    origin: Annotated[Quantity, measured("m", 3)]
    x_axis: Annotated[Quantity, measured("1", 3)]
    y_axis: Annotated[Quantity, measured("1", 3)]
    noise: Annotated[Quantity, measured("1", 2)]
    minimum_sum: Annotated[Quantity, measured("A")]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, axis in (("x_axis", self.x_axis), ("y_axis", self.y_axis)):
            length = float(np.linalg.norm(axis.array))
            if abs(length - 1.0) > 1e-6:  # noqa: PLR2004
                msg = f"{name} {axis.value} has length {length:.9g}, expected a unit vector"
                raise ValueError(msg)
        sine = float(np.linalg.norm(np.cross(self.x_axis.array, self.y_axis.array)))
        if sine < 0.5:  # noqa: PLR2004
            msg = f"x_axis and y_axis are nearly parallel (sine {sine:.3g}), expected axes near a right angle"
            raise ValueError(msg)
        if not np.all(self.noise.array > 0.0):
            msg = f"noise {self.noise.value}, expected more than 0"
            raise ValueError(msg)
        if not self.minimum_sum.number > 0.0:
            msg = f"minimum_sum {self.minimum_sum.value}, expected more than 0 A"
            raise ValueError(msg)
        return self


class LightSourceCalibration(FrozenModel):
    """One light source on the target plate T: where its ray starts and where it goes."""

    name: str
    origin: Annotated[Quantity, measured("m", 3)]
    direction: Annotated[Quantity, measured("1", 3)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        length = float(np.linalg.norm(self.direction.array))
        if abs(length - 1.0) > 1e-6:  # noqa: PLR2004
            msg = f"direction {self.direction.value} has length {length:.9g}, expected a unit vector"
            raise ValueError(msg)
        return self


class DiodesCalibration(SensorCalibration):
    """Diodes, the sources they see, and named sets of maps (one map for each diode in each set)."""

    type: Literal["diodes"]
    diodes: Annotated[list[DiodeCalibration], Field(min_length=1, max_length=4)]
    light_sources: Annotated[list[LightSourceCalibration], Field(min_length=1, max_length=250)]
    map: str
    maps: dict[str, list[SpotMapCalibration]]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, maps in self.maps.items():
            if len(maps) != len(self.diodes):
                msg = f"maps.{name} has {len(maps)} maps, expected {len(self.diodes)}, one for each diode"
                raise ValueError(msg)
        if self.map not in self.maps:
            msg = f"map '{self.map}', expected one of {', '.join(self.maps)}"
            raise ValueError(msg)
        return self

    def build(self) -> Diodes:
        """Return the sensor."""
        return Diodes(self)

    def for_session(self, session: Session) -> Self:
        """Return the calibration with the session's set of maps.

        Raises:
            CalibrationError: There is no set of that name.

        """
        if session.diode_map is None:
            return self
        if session.diode_map not in self.maps:
            raise CalibrationError(
                f"'{session.diode_map}'", where="diode_map of the session", expected=f"one of {', '.join(self.maps)}"
            )
        return self.model_copy(update={"map": session.diode_map})


class Diodes(Sensor):
    """Diodes with their maps; two rows, x and y, for each diode."""

    def __init__(self, calibration: DiodesCalibration) -> None:
        """Take the parameters out of a validated calibration."""
        diodes, sources, maps = calibration.diodes, calibration.light_sources, calibration.maps[calibration.map]
        self._names = tuple(diode.name for diode in diodes)
        self._noise = np.array([diode.noise.array for diode in diodes])
        self._minimum_sums = np.array([diode.minimum_sum.number for diode in diodes])
        self._centers = np.array([m.center.array for m in maps])
        self._domains = np.array([m.domain.array for m in maps])
        shape = tuple(max(m.x.array.shape[axis] for m in maps) for axis in (0, 1))

        def padded(table: FloatArray) -> FloatArray:
            return np.pad(table, [(0, shape[0] - table.shape[0]), (0, shape[1] - table.shape[1])])

        super().__init__(
            {
                "origins": np.array([d.origin.array for d in diodes]),
                "x_axes": np.array([d.x_axis.array for d in diodes]),
                "y_axes": np.array([d.y_axis.array for d in diodes]),
                "maps": np.array([[padded(m.x.array), padded(m.y.array)] for m in maps]),
                "source_origins": np.array([s.origin.array for s in sources]),
                "source_directions": np.array([s.direction.array for s in sources]),
            },
            {
                "origins": np.array([d.origin.sigmas for d in diodes]),
                "x_axes": np.array([d.x_axis.sigmas for d in diodes]),
                "y_axes": np.array([d.y_axis.sigmas for d in diodes]),
                "maps": np.array([[padded(m.x.sigmas), padded(m.y.sigmas)] for m in maps]),
                "source_origins": np.array([s.origin.sigmas for s in sources]),
                "source_directions": np.array([s.direction.sigmas for s in sources]),
            },
        )

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``spot x <diode>``, ``spot y <diode>`` for each diode."""
        return tuple(f"spot {axis} {name}" for name in self._names for axis in "xy")

    @property
    def kinds(self) -> IntArray:
        """Two rows for each diode."""
        return np.tile(np.array([SPOT_X, SPOT_Y], dtype=np.int64), len(self._names))

    def _lit(self, scan: Scan) -> tuple[int, ...]:
        """Return the index of the source that each diode sees."""
        count = len(self._parameters["source_origins"])
        where = f"scan {scan.number}"
        if len(scan.lit_sources) != len(self._names):
            raise ScanError(
                f"{len(scan.lit_sources)} lit sources",
                fault=Fault.SOURCE,
                where=where,
                expected=f"{len(self._names)}, one for each diode",
            )
        for name, lit in zip(self._names, scan.lit_sources, strict=True):
            if lit == NO_SOURCE:
                raise ScanError("no light source was lit", fault=Fault.SOURCE, where=f"{where}, diode {name}")
            if not 0 <= lit < count:
                raise ScanError(
                    f"light source {lit}",
                    fault=Fault.SOURCE,
                    where=f"{where}, diode {name}",
                    expected=f"0 to {count - 1}",
                )
        return scan.lit_sources

    def rows(self, scan: Scan) -> FloatArray:
        """Return the geometry rows for the sources that this scan lit, shape (2 x diodes, ROW_WIDTH)."""
        p = self._parameters
        rows = np.zeros((2 * len(self._names), ROW_WIDTH))
        for i, lit in enumerate(self._lit(scan)):
            for row in rows[2 * i : 2 * i + 2]:
                row[0:3] = p["origins"][i]
                row[3:6] = p["x_axes"][i]
                row[6:9] = p["y_axes"][i]
                row[9:12] = p["source_origins"][lit]
                row[12:15] = p["source_directions"][lit]
        return rows

    def _centred_ratios(self, scan: Scan) -> FloatArray:
        """Return each diode's current ratios minus the map's centre, shape (diodes, 2)."""
        where = f"scan {scan.number}"
        currents = scan.diode_currents
        if currents.shape != (len(self._names), 4):
            raise ScanError(
                f"{currents.size} contact currents",
                fault=Fault.BAD_READING,
                where=where,
                expected=f"{4 * len(self._names)}",
            )
        ratios = np.empty((len(self._names), 2))
        for i, name in enumerate(self._names):
            here = f"{where}, diode {name}"
            a, b, c, d = (float(current) for current in currents[i])
            if not all(map(math.isfinite, (a, b, c, d))):
                raise ScanError(
                    f"contact currents {a}, {b}, {c}, {d}",
                    fault=Fault.BAD_READING,
                    where=here,
                    expected="finite currents",
                )
            least = self._minimum_sums[i]
            for contacts, total in (("A + C", a + c), ("B + D", b + d)):
                if not total >= least:
                    raise ScanError(
                        f"{contacts} = {total:.3g} A is too dark",
                        fault=Fault.DARK_DIODE,
                        where=here,
                        expected=f"at least {least:.3g} A",
                    )
            ratios[i] = (a - c) / (a + c), (b - d) / (b + d)
            for axis, ratio, (low, high) in zip("xy", ratios[i], self._domains[i], strict=True):
                if not low <= ratio <= high:
                    raise ScanError(
                        f"{axis} ratio {ratio:.6g} is outside the calibrated map",
                        fault=Fault.OUT_OF_RANGE,
                        where=here,
                        expected=f"{low:g} to {high:g}",
                    )
        return np.asarray(ratios - self._centers)

    def linearise(self, scan: Scan) -> Linearised:
        """Return the spot positions x, y of each diode in turn [m] and their variances [m^2]."""
        maps = self._parameters["maps"]
        values, variances = [], []
        for i, (u, v) in enumerate(self._centred_ratios(scan)):
            values.append(position(maps[i], u, v))
            variances.append(np.square(slope(maps[i], u, v)) @ np.square(self._noise[i]))
        return Linearised(np.concatenate(values), np.concatenate(variances))

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(spot read - spot predicted)/d(parameter), shape (2 x diodes, p)."""
        rows = self.rows(scan)
        centred = self._centred_ratios(scan)
        maps = self._parameters["maps"]
        out = np.zeros((len(rows), self._sigmas.size))
        geometry = np.empty(kernel.PARAMETERS)
        size = maps[0, 0].size
        for r, row in enumerate(rows):
            i, axis = divmod(r, 2)
            lit = scan.lit_sources[i]
            kernel.spot_parameters(row, rotation, translation, axis, geometry)
            for name, index, start in (
                ("origins", i, 0),
                ("x_axes", i, 3),
                ("y_axes", i, 6),
                ("source_origins", lit, 9),
                ("source_directions", lit, 12),
            ):
                out[r, self._slices[name]][3 * index : 3 * index + 3] = -geometry[start : start + 3]
            u, v = centred[i]
            basis = np.outer(powers(u, maps.shape[2]), powers(v, maps.shape[3]))
            out[r, self._slices["maps"]][size * r : size * (r + 1)] = basis.ravel()
        return out

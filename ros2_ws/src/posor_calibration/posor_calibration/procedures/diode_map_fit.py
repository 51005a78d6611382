# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Map of a lateral effect diode, from current ratios to the spot's position, over a grid of dwells.

Two kinds: ``chebyshev``, a smooth surface, and ``curves``, the map of 1985 with polynomials along the lines of the grid
(thesis 7.4.2). Leave-one-out residuals choose the order; their table against the order is as tables 7.3 to 7.6.
The positions are the reference's: its zero becomes the diode's origin, its axes the diode's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.bags.recording import POINT
from posor.calibration.calibration_file import find_sensor
from posor.errors import FitError, TrackError
from posor.sensors.diodes import DiodesCalibration
from pydantic import Field

from posor_calibration.data_checks import check_axis, check_channels_move, check_count, check_unit
from posor_calibration.diode_spots import AXES, SingleDiode, average_stage_dwells, current_ratios
from posor_calibration.dwells import DwellMeans, RestOptions
from posor_calibration.fit_report import describe_enlargement, describe_rejected
from posor_calibration.map_basis import (
    FEWEST_CURVES,
    UM,
    Design,
    choose_order,
    curve_design,
    doubled_grid_errors,
    fit_positions,
    surface_design,
    surface_terms,
    tabulate_interpolation,
)
from posor_calibration.procedure import Figure, Outcome, Part, Procedure, Table

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_calibration.least_squares import Fit

NAME = "diode_map"
MIN_DWELLS = 9
SAME_LINE = 0.25  # dwells closer than this across a line of the grid, over its pitch, lie on the same line
COMPARED_RATIOS = 50  # ratios at which neighbouring curves of a map are compared
MM = 1e-3


class DiodeMapOptions(RestOptions):
    """Options of ``diode_map``."""

    diode: str = Field(default="", description="name of the diode; empty: the only one")
    reference: str = Field(
        default="", description="topic of the stage's point, axes along the diode's; empty: the only one"
    )
    direction: Literal[1, -1] = Field(
        default=1,
        description="1: the reference moves as the light does over the diode; -1: as the diode under the light",
    )
    kind: Literal["chebyshev", "curves"] = Field(
        default="chebyshev", description="smooth surface, or curves along the grid's lines as in 1985"
    )
    set_name: str = Field(default="", description="set of maps that receives the map; empty: the one in use")
    orders: tuple[int, int] = Field(default=(1, 9), description="lowest and highest order to choose from")


@dataclass(frozen=True)
class _Grid:
    """Means over the dwells of a grid."""

    ratios: FloatArray  # (d, 2)
    positions: FloatArray  # of the spot [m], (d, 2)
    sigmas: FloatArray  # standard uncertainty of the positions, with that of the ratios [m], (d, 2)

    @property
    def domain(self) -> FloatArray:
        """Least and largest of each ratio, (2, 2)."""
        return np.column_stack([self.ratios.min(axis=0), self.ratios.max(axis=0)])


def map_diode(recording: Recording, calibration: Calibration, options: DiodeMapOptions) -> Outcome:
    """Find the map of one diode; raises as ``Procedure.identify``."""
    sensor, part = find_sensor(calibration, DiodesCalibration, NAME)
    index = _find_diode(part, options.diode)
    track = recording.find_track(options.reference, POINT)
    means = average_stage_dwells(recording, track, MIN_DWELLS, options, NAME)
    grid = _make_grid(means, part, index, options, track.source)
    diode = part.diodes[index].name
    design, content = (_make_surface if options.kind == "chebyshev" else _make_curves)(grid)
    orders = range(options.orders[0], options.orders[1] + 1)
    order, table = choose_order(design, grid.positions, orders, f"residual against order, diode {diode}")
    names = [f"dwell at ({x / MM:.3f}, {y / MM:.3f}) mm" for x, y in grid.positions]
    fits, used, warnings = [], [], [*means.warnings]
    for axis, name in enumerate("xy"):
        fit, outliers = fit_positions(
            design(order, axis), grid.positions[:, axis], grid.sigmas[:, axis], name, what=NAME
        )
        warnings += [*describe_rejected(outliers, names, NAME), *describe_enlargement(fit, NAME)]
        fits.append(fit)
        used.append(~outliers)
    entry = content(order, fits)
    return Outcome(
        method=f"{options.kind} map of order {order}, chosen by leave-one-out residuals, from {len(grid.ratios)} "
        "dwells (thesis 7.4.2)",
        fits={f"{diode} {axis}": fit for axis, fit in zip("xy", fits, strict=True)},
        parts=_file_parts(part, sensor, index, options.set_name or part.map, entry),
        tables=(table, *_interpolation_tables(entry, grid.domain)),
        warnings=tuple(warnings),
        figures=(_plot_residuals(grid, fits, used),),
    )


def _find_diode(part: DiodesCalibration, name: str) -> int:
    names = [diode.name for diode in part.diodes]
    if not name and len(names) == 1:
        return 0
    if name not in names:
        raise FitError(f"diode '{name}'", where=NAME, expected=f"one of {', '.join(names)}")
    return names.index(name)


def _make_grid(means: DwellMeans, part: DiodesCalibration, index: int, options: DiodeMapOptions, source: str) -> _Grid:
    """Return the dwells with light on the diode, after checking that reference and readings belong together."""
    currents = means.scans.diode_currents
    if currents.shape[1] != len(part.diodes):
        raise FitError(f"scans of {currents.shape[1]} diodes", where=NAME, expected=f"{len(part.diodes)}")
    diode, own = part.diodes[index], currents[:, index]
    lit = np.asarray(np.all(own[:, :2] + own[:, 2:] >= diode.sums[0], axis=1))
    check_count(int(lit.sum()), MIN_DWELLS, f"dwells with light on diode {diode.name}", NAME)
    ratios = current_ratios(own[lit])
    positions = options.direction * means.reference[lit, :2]
    channels = [f"diode {diode.name}, {axis} ratio" for axis in "xy"]
    check_channels_move(channels, ratios, np.zeros_like(ratios), positions, source)
    for axis in range(2):
        check_axis(ratios[:, axis], means.reference[lit], axis, AXES, source)
    present = SingleDiode(part, index, means.scans.select(lit))
    if int(present.seen.sum()) >= MIN_DWELLS:
        for axis in range(2):
            check_unit(present.spots[:, axis], positions[present.seen, axis], source, "m")
    _check_zero(positions, source)
    noise = diode.noise.array / np.sqrt(means.counts[lit])[:, None]
    slopes = np.abs([np.polyfit(ratios[:, axis], positions[:, axis], 1)[0] for axis in range(2)])
    return _Grid(ratios, positions, np.hypot(means.reference_sigmas[lit, :2], slopes * noise))


def _check_zero(positions: FloatArray, source: str) -> None:
    """Raise TrackError if the zero of the reference, which becomes the diode's origin, is not within the grid."""
    for axis, low, high in zip("xy", positions.min(axis=0), positions.max(axis=0), strict=True):
        if not low <= 0.0 <= high:
            raise TrackError(
                f"the dwells are at {axis} from {low:g} to {high:g} m, without 0, which becomes the diode's origin",
                where=source,
                expected="positions that are zero in the middle of the diode",
            )


MapKind = tuple["Callable[[int, int], Design]", "Callable[[int, list[Fit]], dict[str, Any]]"]
"""Design for an order and an axis; content of the file for an order and the fits of both axes."""


def _quantity(value: FloatArray, unit: str, sigma: FloatArray | None = None) -> dict[str, Any]:
    return {"value": value.tolist(), **({} if sigma is None else {"sigma": sigma.tolist()}), "unit": unit}


def _make_surface(grid: _Grid) -> MapKind:
    scaled = (grid.ratios - grid.domain.mean(axis=1)) / (0.5 * np.ptp(grid.domain, axis=1))

    def content(order: int, fits: list[Fit]) -> dict[str, Any]:
        entry: dict[str, Any] = {"kind": "chebyshev", "domain": _quantity(grid.domain, "1")}
        where = tuple(np.array(surface_terms(order)).T)
        for axis, fit in zip("xy", fits, strict=True):
            values, sigmas = np.zeros((order + 1, order + 1)), np.zeros((order + 1, order + 1))
            values[where], sigmas[where] = fit.values, fit.sigmas
            entry[axis] = _quantity(values, "m", sigmas)
        return entry

    return lambda order, _: surface_design(scaled, order), content


def _make_curves(grid: _Grid) -> MapKind:
    """Return design and file content of curves along the lines of the grid; raise FitError if it is not square."""
    # Curve i of x lies on the i-th line of constant y, and the other way round.
    lines, at = zip(*(_find_lines(grid.positions[:, 1 - axis], "xy"[1 - axis]) for axis in range(2)), strict=True)
    if len(at[0]) != len(at[1]):
        what = f"a grid of {len(at[1])} by {len(at[0])} lines"
        raise FitError(what, where=NAME, expected="as many along x as along y, for a map of curves")

    def content(order: int, fits: list[Fit]) -> dict[str, Any]:
        entry: dict[str, Any] = {"kind": "curves", "domain": _quantity(grid.domain, "1")}
        for axis, fit in enumerate(fits):
            shape = (len(at[axis]), order + 1)
            entry[f"{'xy'[axis]}_curves"] = _quantity(fit.values.reshape(shape), "m", fit.sigmas.reshape(shape))
            entry[f"{'xy'[axis]}_curves_at"] = _quantity(at[axis], "m")
        return entry

    return lambda order, axis: curve_design(grid.ratios[:, axis], lines[axis], order), content


def _interpolation_tables(entry: dict[str, Any], domain: FloatArray) -> tuple[Table, ...]:
    """Return the table of the error between the curves; none for another kind of map, or fewer than three curves."""
    if entry["kind"] != "curves" or len(entry["x_curves_at"]["value"]) < FEWEST_CURVES:
        return ()
    errors = {
        axis: doubled_grid_errors(
            np.array(entry[f"{axis}_curves"]["value"]),
            np.array(entry[f"{axis}_curves_at"]["value"]),
            np.linspace(low, high, COMPARED_RATIOS),
        )
        for axis, (low, high) in zip("xy", domain, strict=True)
    }
    return (tabulate_interpolation(errors),)


def _find_lines(across: FloatArray, name: str) -> tuple[IntArray, FloatArray]:
    """Return the line of each dwell (d,) and the positions of the lines (l,), from positions across them (d,)."""
    order = np.argsort(across)
    gaps = np.diff(across[order])
    lines = np.empty(len(across), dtype=np.int64)
    lines[order] = np.concatenate([[0], np.cumsum(gaps > SAME_LINE * float(gaps.max(initial=0.0)))])
    if not lines.any():
        raise FitError(f"all dwells are on one line along {name}", where=NAME, expected="a grid")
    return lines, np.array([across[lines == line].mean() for line in range(int(lines.max()) + 1)])


def _file_parts(part: DiodesCalibration, sensor: int, index: int, name: str, entry: dict[str, Any]) -> tuple[Part, ...]:
    """Return the changes to the file: the map, within a new set where the set is new."""
    key = f"sensors[{sensor}].maps.{name}"
    if name in part.maps:
        return (Part(f"{key}[{index}]", entry),)
    entries = [other.model_dump(mode="json", exclude_defaults=True) for other in part.maps[part.map]]
    entries[index] = entry
    return Part(key, entries), Part(f"sensors[{sensor}].map", name)


def _plot_residuals(grid: _Grid, fits: list[Fit], used: list[BoolArray]) -> Figure:
    series = {
        axis: (grid.positions[own, i] / MM, fit.residuals * grid.sigmas[own, i] / UM)
        for i, (axis, fit, own) in enumerate(zip("xy", fits, used, strict=True))
    }
    return Figure("residuals of the map", "position [mm]", "residual [um]", series)


PROCEDURE = Procedure(NAME, "map of a diode, ratios to position, from a grid of dwells", DiodeMapOptions, map_diode)

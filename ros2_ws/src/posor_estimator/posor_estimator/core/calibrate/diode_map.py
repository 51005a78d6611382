"""Map of a lateral effect diode: contact-current ratios to the spot's position, from a scan over a grid of stops.

Two kinds: ``chebyshev``, a smooth surface, and ``curves``, the map of 1985: polynomials along the lines of the grid
(thesis 7.4.3). The order is chosen by leave-one-out residuals; the table of residual against order is what tables 7.3
to 7.6 are. The positions are the reference's own: its zero becomes the diode's origin, its axes the diode's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.channels import check_channels
from posor_estimator.core.calibrate.checks import (
    check_alive,
    check_axis,
    check_enough,
    check_unit,
    misfit_sentences,
    outlier_sentences,
)
from posor_estimator.core.calibrate.joining import Stops, stops
from posor_estimator.core.calibrate.one_diode import OneDiode, ratios_of
from posor_estimator.core.calibrate.parameters import the_sensor
from posor_estimator.core.calibrate.procedure import Figure, Options, Outcome, Procedure
from posor_estimator.core.calibrate.recording import DIODES_ESTIMATED, POINT, SATURATED
from posor_estimator.core.calibrate.replacement import Part
from posor_estimator.core.calibrate.spot_surface import (
    Design,
    chosen_order,
    curve_design,
    linear_fit,
    smooth_design,
    smooth_terms,
)
from posor_estimator.core.calibrate.track import dwells
from posor_estimator.core.sensors.diodes import DiodesCalibration
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

NAME = "diode_map"
LEAST_STOPS = 9
AXES = ("x", "y", "z")
SAME_LINE = 0.25
"""Of the pitch of the grid: stops closer than this across a line are on it."""
UM = 1e-6


class DiodeMapOptions(Options):
    """Options of the diode map."""

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
    set_name: str = Field(default="", description="set of maps that takes the map; empty: the one in use")
    orders: tuple[int, int] = Field(default=(1, 9), description="lowest and highest order to choose from")
    still: float = Field(default=5e-6, gt=0.0, description="the reference stands still within this [m]")
    least_dwell: float = Field(default=0.2, ge=0.0, description="shorter stops are none [s]")
    settle: float = Field(default=0.0, ge=0.0, description="left out at the beginning of each stop [s]")


@dataclass(frozen=True)
class Grid:
    """Means over the stops of a grid.

    Attributes:
        ratios: (d, 2).
        positions: Of the spot [m], (d, 2).
        sigmas: Standard uncertainty of the positions, that of the ratios included [m], (d, 2).

    """

    ratios: FloatArray
    positions: FloatArray
    sigmas: FloatArray


def map_diode(recording: Recording, calibration: Calibration, options: DiodeMapOptions) -> Outcome:
    """Find the map of one diode; see ``DiodeMapOptions``.

    Raises:
        FitError: The stops do not determine the map, or the diode's readings do not serve.
        TrackError: The reference does not serve.

    """
    sensor, part = the_sensor(calibration, DiodesCalibration, NAME)
    index = _index(part, options.diode)
    recording = recording.without(DIODES_ESTIMATED | SATURATED)
    track = recording.track(options.reference, POINT)
    found = dwells(track, options.still, round(options.least_dwell * 1e9), settle_ns=round(options.settle * 1e9))
    check_enough(len(found), LEAST_STOPS, "stops of the reference", f"{NAME}, {track.source}")
    check_channels(recording.scans, ("diode_currents",), recording.source)
    at_stops = stops(recording.scans, track, found, what=recording.source, judged=("diode_currents",))
    grid = _grid(at_stops, part, index, options, track.source)
    lowest, highest = options.orders
    orders = range(lowest, highest + 1)
    make, content = (_smooth if options.kind == "chebyshev" else _curves)(grid)
    order, table = chosen_order(
        make, grid.positions, orders, f"residual against order, diode {part.diodes[index].name}"
    )
    names = [f"stop at ({x / 1e-3:.3f}, {y / 1e-3:.3f}) mm" for x, y in grid.positions]
    fits, kept, warnings = [], [], [*at_stops.warnings]
    for axis, name in enumerate("xy"):
        fit, outliers = linear_fit(make(order, axis), grid.positions[:, axis], grid.sigmas[:, axis], name, what=NAME)
        warnings += [*outlier_sentences(outliers, names, NAME), *misfit_sentences(fit, NAME)]
        fits.append(fit)
        kept.append(~outliers)
    name = options.set_name or part.map
    return Outcome(
        method=f"{options.kind} map of order {order}, chosen by leave-one-out residuals, of {len(grid.ratios)} stops "
        "(thesis 7.4.3)",
        fits={f"{part.diodes[index].name} {axis}": fit for axis, fit in zip("xy", fits, strict=True)},
        parts=_parts(part, sensor, index, name, content(order, fits)),
        tables=(table,),
        warnings=tuple(warnings),
        figures=(_figure(grid, fits, kept),),
    )


def _index(part: DiodesCalibration, name: str) -> int:
    names = [diode.name for diode in part.diodes]
    if not name and len(names) == 1:
        return 0
    if name not in names:
        raise FitError(f"diode '{name}'", where=NAME, expected=f"one of {', '.join(names)}")
    return names.index(name)


def _grid(at_stops: Stops, part: DiodesCalibration, index: int, options: DiodeMapOptions, source: str) -> Grid:
    currents = at_stops.scans.diode_currents
    if currents.shape[1] != len(part.diodes):
        raise FitError(f"scans of {currents.shape[1]} diodes", where=NAME, expected=f"{len(part.diodes)}")
    diode, name = part.diodes[index], part.diodes[index].name
    lit = _lit(currents[:, index], diode.sums[0])
    check_enough(int(lit.sum()), LEAST_STOPS, f"stops with light on diode {name}", NAME)
    ratios = ratios_of(currents[lit, index])
    positions = options.direction * at_stops.reference[lit, :2]
    counts = at_stops.counts[lit]
    noise = diode.noise.array / np.sqrt(counts)[:, None]
    check_alive([f"diode {name}, {axis} ratio" for axis in "xy"], ratios, np.zeros_like(ratios), positions, source)
    for axis in range(2):
        check_axis(ratios[:, axis], at_stops.reference[lit], axis, AXES, source)
    before = OneDiode(part, index, at_stops.scans.chosen(lit))
    if int(before.seen.sum()) >= LEAST_STOPS:
        for axis in range(2):
            check_unit(before.spots[:, axis], positions[before.seen, axis], source, "m")
    slopes = np.abs([np.polyfit(ratios[:, axis], positions[:, axis], 1)[0] for axis in range(2)])
    return Grid(ratios, positions, np.hypot(at_stops.reference_sigmas[lit, :2], slopes * noise))


def _lit(currents: FloatArray, least: float) -> BoolArray:
    """Return which stops have light enough, (d,)."""
    return np.asarray(np.all(currents[:, :2] + currents[:, 2:] >= least, axis=1))


MapMaker = tuple["Callable[[int, int], Design]", "Callable[[int, list[Fit]], dict[str, Any]]"]


def _quantity(value: FloatArray, unit: str, sigma: FloatArray | None = None) -> dict[str, Any]:
    made: dict[str, Any] = {"value": value.tolist()}
    return {**made, **({} if sigma is None else {"sigma": sigma.tolist()}), "unit": unit}


def _domain(grid: Grid) -> FloatArray:
    return np.column_stack([grid.ratios.min(axis=0), grid.ratios.max(axis=0)])


def _smooth(grid: Grid) -> MapMaker:
    """Return the design of a smooth surface, and what the file says of it."""
    domain = _domain(grid)
    scaled = (grid.ratios - domain.mean(axis=1)) / (0.5 * np.ptp(domain, axis=1))

    def content(order: int, fits: list[Fit]) -> dict[str, Any]:
        made: dict[str, Any] = {"kind": "chebyshev", "domain": _quantity(domain, "1")}
        where = tuple(np.array(smooth_terms(order)).T)
        for axis, fit in zip("xy", fits, strict=True):
            values, sigmas = np.zeros((order + 1, order + 1)), np.zeros((order + 1, order + 1))
            values[where], sigmas[where] = fit.values, fit.sigmas
            made[axis] = _quantity(values, "m", sigmas)
        return made

    return lambda order, _: smooth_design(scaled, order), content


def _curves(grid: Grid) -> MapMaker:
    """Return the design of curves along the lines of the grid, and what the file says of them.

    Raises:
        FitError: The stops are not a grid of as many lines along x as along y.

    """
    # Curve i of x lies on the i-th line of constant y, and the other way round.
    lines, at = zip(*(_lines(grid.positions[:, 1 - axis], "xy"[1 - axis]) for axis in range(2)), strict=True)
    if len(at[0]) != len(at[1]):
        what = f"a grid of {len(at[1])} by {len(at[0])} lines"
        raise FitError(what, where=NAME, expected="as many along x as along y, for a map of curves")

    def content(order: int, fits: list[Fit]) -> dict[str, Any]:
        made: dict[str, Any] = {"kind": "curves", "domain": _quantity(_domain(grid), "1")}
        for axis, fit in enumerate(fits):
            shape = (len(at[axis]), order + 1)
            made[f"{'xy'[axis]}_curves"] = _quantity(fit.values.reshape(shape), "m", fit.sigmas.reshape(shape))
            made[f"{'xy'[axis]}_curves_at"] = _quantity(at[axis], "m")
        return made

    return lambda order, axis: curve_design(grid.ratios[:, axis], lines[axis], order), content


def _lines(across: FloatArray, name: str) -> tuple[IntArray, FloatArray]:
    """Return which line each stop is on (d,), and where the lines are (l,), by the stops' positions across them."""
    order = np.argsort(across)
    gaps = np.diff(across[order])
    largest = float(gaps.max(initial=0.0))
    starts = np.concatenate([[0], np.cumsum(gaps > SAME_LINE * largest)])
    lines = np.empty(len(across), dtype=np.int64)
    lines[order] = starts
    at = np.array([across[lines == line].mean() for line in range(int(starts[-1]) + 1)])
    if len(at) < 2:  # noqa: PLR2004
        raise FitError(f"all stops are on one line along {name}", where=NAME, expected="a grid")
    return lines, at


def _parts(part: DiodesCalibration, sensor: int, index: int, name: str, made: dict[str, Any]) -> tuple[Part, ...]:
    """Return what goes into the file: the map, in a set of its own where the set is new."""
    key = f"sensors[{sensor}].maps.{name}"
    if name in part.maps:
        return (Part(f"{key}[{index}]", made),)
    others = [one.model_dump(mode="json", exclude_defaults=True) for one in part.maps[part.map]]
    others[index] = made
    return Part(key, others), Part(f"sensors[{sensor}].map", name)


def _figure(grid: Grid, fits: list[Fit], kept: list[BoolArray]) -> Figure:
    series = {
        axis: (grid.positions[own, i] / 1e-3, fit.residuals * grid.sigmas[own, i] / UM)
        for i, (axis, fit, own) in enumerate(zip("xy", fits, kept, strict=True))
    }
    return Figure("residuals of the map", "position [mm]", "residual [um]", series)


PROCEDURE = Procedure(NAME, "map of a diode, ratios to position, from a grid of stops", DiodeMapOptions, map_diode)

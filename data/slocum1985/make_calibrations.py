# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make the calibration files of the 1985 rig from the numbers of the thesis.

Usage, with the Python of the workspace: ``python data/slocum1985/make_calibrations.py [OUTPUT_FOLDER]``. Reads the CSV
files of this folder and writes ``slocum1985_printed.yaml`` and ``slocum1985_section84.yaml``, the same bytes on every
run. The notes of the files state what is quoted, derived and assumed.
"""

from __future__ import annotations

import csv
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from posor.calibration.document_text import document_text

HERE = Path(__file__).resolve().parent
DEFAULT_OUTPUT = HERE.parents[1] / "ros2_ws/src/posor_bringup/config"
INCH = 0.0254
MICROINCH = INCH * 1e-6

PROBE_NOISE_UIN = (7.0, 21.0, 25.0)  # table 7.12, random rows
DIODE_NOISE_UIN = (80.0, 50.0)  # table 7.9, repeatability, the same along x and y
LINEARISATION_UIN = {"xd1": 209.0, "yd1": 137.0, "xd2": 206.0, "yd2": 85.0}  # table 7.9
PROBE_LINEARITY_UIN = 5.0  # table 7.12, sigma_alphabeta_li
DIODE_ORIGIN_SIGMA_IN = (0.001541, 0.000037)  # section 7.4.4: of the offset between the diodes, x and y
DOMAINS = (((0.502, 0.526), (0.01, 0.106)), ((0.497, 0.548), (-0.030, 0.063)))  # where the local fits hold
TABLES_PROBE_1_CONSTANT_IN = 0.133333
VOLT_RANGE = (-0.6, 1.2)
NOMINAL_TEST = "YMO"
COEFFICIENTS = ("A0_in", "A1_in_per_V", "A2_in_per_V2", "A3_in_per_V3", "A4_in_per_V4")

SOURCE = "A. H. Slocum, Sensor System Design to Determine Position and Orientation of Articulated Structures, MIT, 1985"
METHOD = (
    "tables 7.8, 7.9, 7.10, 7.12, 8.1, section 7.4.4, listings of appendix 8A; "
    "made by data/slocum1985/make_calibrations.py"
)
NOTES = (
    (
        "derived: target plane tilt from the flatness constants of the listings; diode maps (local fits); source "
        "origins from the start of test YMO in table 8.1"
    ),
    (
        "assumed: probe axes along Z of R; at the start of test YMO the rotation axis of the target leans along X only "
        "and the rays have no length; what the gaps show then is taken for offsets of the probe tips along Z; "
        f"calibrated voltage range {VOLT_RANGE[0]} to {VOLT_RANGE[1]} V after the zero shift; least current sum 20 uA"
    ),
    "tilt_angle previous_scan: the program of appendix 8A turned the tilt by the theta of the step before",
)

Array = np.ndarray[Any, np.dtype[np.float64]]
ZERO_SHIFTS = (0.0, 0.2, 0.3)


def rows(name: str) -> list[dict[str, str]]:
    """Return the rows of one CSV file, comment lines skipped."""
    with (HERE / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def dimensions() -> dict[str, float]:
    """Return posor_dimensions.csv as name to value (inch, radian)."""
    return {row["quantity"]: float(row["value"]) for row in rows("posor_dimensions.csv")}


def quantity(value: Any, unit: str, sigma: Any = None) -> dict[str, Any]:
    """Return a quantity of the calibration file."""
    sigmas = {} if sigma is None else {"sigma": np.array(sigma, dtype=float).tolist()}
    return {"value": np.array(value, dtype=float).tolist(), **sigmas, "unit": unit}


def gap_probes(d: dict[str, float], tilt: tuple[float, float], start: NominalStart) -> dict[str, Any]:
    """Return the gap probes: probe 1 at (-c, 0), probe 2 at (0, a), probe 3 at (0, -b)."""
    sigma = {row["quantity"]: row["sigma"] for row in rows("posor_dimensions.csv")}
    a, b, c = (float(sigma[name]) * INCH for name in "abc")
    tips = ((-d["c"], 0.0), (0.0, d["a"]), (0.0, -d["b"]))
    sigmas = ((c, 0.0, 0.0), (0.0, a, 0.0), (0.0, b, 0.0))
    probes = []
    for i, row in enumerate(rows("probe_linearization.csv")):
        coefficients = np.array([float(row[column]) for column in COEFFICIENTS]) * INCH
        probes.append(
            {
                "name": f"probe_{row['probe']}",
                "tip": quantity([tips[i][0] * INCH, tips[i][1] * INCH, start.tip_offsets[i]], "m", sigmas[i]),
                "axis": quantity([0.0, 0.0, 1.0], "1"),
                "volts_to_gap": quantity(coefficients, "m/V^k", [PROBE_LINEARITY_UIN * MICROINCH, 0, 0, 0, 0]),
                "zero_shift": quantity(ZERO_SHIFTS[i], "V"),
                "noise": quantity(PROBE_NOISE_UIN[i] * MICROINCH / abs(coefficients[1]), "V"),
                "range": quantity(VOLT_RANGE, "V"),
            }
        )
    plane = {"point": quantity([0.0, 0.0, 0.0], "m"), "tilt": quantity(tilt, "rad")}
    return {"type": "gap_probes", "target_plane": plane, "probes": probes}


def local_fits() -> dict[tuple[str, str], dict[str, float]]:
    """Return the coefficients [inch] of the derived local calibration by (variant, quantity)."""
    return {
        (row["variant"], row["quantity"]): {name: float(cell) for name, cell in row.items() if name.endswith("_in")}
        for row in rows("diode_local_calibration.csv")
    }


def local_map(variant: str, diode: int) -> dict[str, Any]:
    """Return one diode's local map; u and v are the ratios less (.51, .06), as the fits have them."""
    axes: dict[str, dict[str, Any]] = {}
    for axis in "xy":
        name = f"{axis}d{diode}"
        fit = {key: value * INCH for key, value in local_fits()[variant, name].items()}
        table = [[fit["c0_in"], fit["cv_in"]], [fit["cu_in"], fit["cuv_in"]], [fit["cuu_in"], 0.0]]
        sigma = [[LINEARISATION_UIN[name] * MICROINCH, 0.0], [0.0, 0.0], [0.0, 0.0]]
        axes[axis] = quantity(table, "m", sigma)
    return {
        "kind": "polynomial",
        "center": quantity([0.51, 0.06], "1"),
        "domain": quantity(DOMAINS[diode - 1], "1"),
        "x": axes["x"],
        "y": axes["y"],
    }


@dataclass(frozen=True)
class NominalStart:
    """Pose of the target at the start of the nominal test, where theta is zero by definition.

    The rotation axis of the target leans along X only, so that the target plane is level along X in R. Differences of
    the gaps from this pose are taken for offsets of the probes along Z.

    Attributes:
        rotation: R_R_T, shape (3, 3).
        distance: Origin of T along Z of R [m].
        tip_offsets: Offsets of the three probe tips along Z of R [m].

    """

    rotation: Array
    distance: float
    tip_offsets: tuple[float, float, float]


def nominal_start(d: dict[str, float], tilt: tuple[float, float], zero_shifts: list[float]) -> NominalStart:
    """Return the nominal start of a rig whose target plane leans by ``tilt`` [rad] in T."""
    first = rows(f"{NOMINAL_TEST.lower()}_input.csv")[0]
    gaps = []
    for k, row in enumerate(rows("probe_linearization.csv")):
        volts = float(first[f"l{k + 1}_v"]) + zero_shifts[k]
        gaps.append(sum(float(row[column]) * volts**power for power, column in enumerate(COEFFICIENTS)) * INCH)
    a, b = d["a"] * INCH, d["b"] * INCH
    distance = (gaps[1] * b + gaps[2] * a) / (a + b)
    normal = np.array(
        [-math.sin(tilt[1]), math.sin(tilt[0]) * math.cos(tilt[1]), -math.cos(tilt[0]) * math.cos(tilt[1])]
    )
    lean = math.atan2(-normal[0], normal[2]) + (math.pi if normal[2] < 0.0 else 0.0)
    rotation = np.array(
        [[math.cos(lean), 0.0, math.sin(lean)], [0.0, 1.0, 0.0], [-math.sin(lean), 0.0, math.cos(lean)]]
    )
    level = rotation @ normal
    slope_y = -level[1] / level[2]
    heights = (distance, distance + slope_y * a, distance - slope_y * b)
    return NominalStart(rotation, distance, (heights[0] - gaps[0], heights[1] - gaps[1], heights[2] - gaps[2]))


def diodes(d: dict[str, float], start: NominalStart) -> dict[str, Any]:
    """Return the two diodes and their sources.

    Diode axes x and y point along -X and -Y of R, since the listings have x = h - X, y = g - Y (h1 - h2 = dXsep,
    g1 - g2 = dYsep, centred on the nominal h = -.566, g = 1.8 and -1.2). At the start of the nominal test, theta zero,
    the sources are at the spots of table 8.1 themselves: like the listings, which correct the spots for the change of
    the plate distance only, this takes the rays to have no length there.
    """
    starts = {
        row["quantity"]: float(row[NOMINAL_TEST]) for row in rows("sensor_ranges.csv") if "_start" in row["quantity"]
    }
    middle_y = (d["g1"] + d["g2"]) / 2.0
    made: dict[str, Any] = {"type": "diodes", "diodes": [], "light_sources": [], "map": "B"}
    fits = local_fits()
    spins = (d["rho1"], d["rho2_table"])
    inclinations = (d["sigma1"], d["sigma2"])
    sources = rows("light_sources.csv")
    for i, side in enumerate((1.0, -1.0)):
        k = i + 1
        origin = np.array([d["h_diodes"] + side * d["dXsep"] / 2.0, middle_y + side * d["dYsep"] / 2.0, 0.0]) * INCH
        offset = np.array(DIODE_ORIGIN_SIGMA_IN) * INCH / math.sqrt(2.0)
        slopes = [abs(fits["B", f"xd{k}"]["cu_in"]), abs(fits["B", f"yd{k}"]["cv_in"])]
        made["diodes"].append(
            {
                "name": f"diode_{k}",
                "origin": quantity(origin, "m", [*offset, 0.0]),
                "x_axis": quantity([-1.0, 0.0, 0.0], "1", [0.0, 2.8e-3, 5e-3]),
                "y_axis": quantity([0.0, -1.0, 0.0], "1", [2.8e-3, 0.0, 5e-3]),
                "noise": quantity([DIODE_NOISE_UIN[i] * 1e-6 / slope for slope in slopes], "1"),
                "minimum_sum": quantity(2e-5, "A"),
            }
        )
        spot = origin - np.array([starts[f"xd{k}_start_in"], starts[f"yd{k}_start_in"], 0.0]) * INCH
        # The corrections of the listings compensate rays inclined by (cos rho, -sin rho) and by (cos rho, sin rho).
        lean = math.tan(inclinations[i])
        direction = np.array([lean * math.cos(spins[i]), -side * lean * math.sin(spins[i]), -1.0])
        lean_sigma = [float(sources[i]["sigma_alpha_Xl_rad"]), float(sources[i]["sigma_beta_Yl_rad"]), 0.0]
        made["light_sources"].append(
            {
                "name": f"source_{k}",
                "origin": quantity(start.rotation.T @ (spot - [0.0, 0.0, start.distance]), "m"),
                "direction": quantity(start.rotation.T @ direction / np.linalg.norm(direction), "1", lean_sigma),
            }
        )
    made["maps"] = {variant: [local_map(variant, 1), local_map(variant, 2)] for variant in "AB"}
    return made


def sessions(*, shifted: bool) -> dict[str, Any]:
    """Return the sessions of the tests: zero shifts (section 8.4: table 8.1) and set of diode maps."""
    shifts = {row["quantity"]: row for row in rows("sensor_ranges.csv")}
    made = {}
    for test, variant in (("ymo", "B"), ("yzmo", "B"), ("zmo", "A")):
        volts = [float(shifts[f"probe{k}_shift_V"][test.upper()]) for k in (1, 2, 3)] if shifted else list(ZERO_SHIFTS)
        origin = "table 8.1" if shifted else "(0, .2, .3) V as in every printed result table"
        made[test] = {
            "note": f"zero shifts: {origin}; diode maps: derived local calibration {variant}",
            "zero_shifts": quantity(volts, "V"),
            "diode_map": variant,
        }
    return made


def calibration(name: str, flatness_in: float, notes: list[str], *, shifted: bool) -> dict[str, Any]:
    """Return the content of one calibration file."""
    d = dimensions()
    a, b, c = d["a"], d["b"], d["c"]
    # The listings add constants times sin(theta) to the gaps. A plane with slopes (ex, ey) in T has the same effect:
    # alpha gains 2 f / (a + b) and beta (k - f (b - a) / (a + b)) / c for each sin(theta).
    slope_x = -2.0 * flatness_in / (a + b)
    slope_y = -(TABLES_PROBE_1_CONSTANT_IN - flatness_in * (b - a) / (a + b)) / c
    about_x = math.atan(slope_y)
    tilt = (about_x, -math.atan(slope_x * math.cos(about_x)))
    start = nominal_start(d, tilt, sessions(shifted=shifted)[NOMINAL_TEST.lower()]["zero_shifts"]["value"])
    return {
        "format": "posor_calibration",
        "version": 1,
        "name": name,
        "provenance": {"source": SOURCE, "method": METHOD, "date": "1985", "notes": [*notes, *NOTES]},
        "frames": {"parent": "posor_receiving", "child": "posor_target"},
        "tilt_angle": "previous_scan",
        "sensors": [gap_probes(d, tilt, start), diodes(d, start)],
        "sessions": sessions(shifted=shifted),
    }


def write(path: Path, content: dict[str, Any]) -> None:
    """Write one file."""
    comment = "Made by data/slocum1985/make_calibrations.py; SI units throughout."
    path.write_text(document_text(content, comment), encoding="utf-8")


def main(output: Path) -> None:
    """Write both files into the output folder."""
    d = dimensions()
    output.mkdir(parents=True, exist_ok=True)
    printed = calibration(
        "slocum1985_printed",
        d["flatness_D2_D3_tables"],
        shifted=False,
        notes=[
            "the state that gives the printed result tables: zero shifts (0, .2, .3) V and flatness f = .0083333 in"
        ],
    )
    section84 = calibration(
        "slocum1985_section84",
        d["flatness_D2_D3_listing"],
        shifted=True,
        notes=[
            "the state that gives the statistics of section 8.4: zero shifts of table 8.1 and flatness f = .083333 in"
        ],
    )
    for content in (printed, section84):
        write(output / f"{content['name']}.yaml", content)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT_OUTPUT)

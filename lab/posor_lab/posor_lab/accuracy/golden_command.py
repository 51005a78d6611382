# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check of the measurement model against a file of ray-traced cases: ``./run posor_lab golden FILE.jsonl``.

Prints one JSON line: for each stack the largest error of a predicted reading [m] and of a recovered pose [m, rad].
Each case is geometry, pose and reading of each sensor, one JSON object per line. A case becomes a calibration whose
linearisations are the identity (one volt is one metre, a current ratio of one is one metre), so that its readings pass
all steps of a scan.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import pinocchio as pin
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.design_parts import quantity_entry
from posor.errors import DataFileError
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.scan import Scan, Scans
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor.numerics.array_types import FloatArray

StackName = Literal["triad_diodes", "triad_bumpy_ring"]

_SPAN = 10.0  # half-width of the range of ratios [1]: wider than any reading
_GAP_SPAN = 0.1  # half-width of the range of voltages, which are gaps of 1 m/V [V]: likewise
_CURRENT = 1e-4  # total current of each axis of a diode [A]
_IDENTITY = {  # map of a diode whose spots [m] are its ratios
    "kind": "polynomial",
    "center": quantity_entry([0.0, 0.0], "1"),
    "domain": quantity_entry([[-_SPAN, _SPAN], [-_SPAN, _SPAN]], "1"),
    "x": quantity_entry([[0.0, 0.0], [1.0, 0.0]], "m"),
    "y": quantity_entry([[0.0, 1.0], [0.0, 0.0]], "m"),
}


@dataclass(frozen=True)
class Case:
    """One ray-traced case, for one stack of its sensors."""

    name: str  # ``case <number>``
    calibration: Calibration  # the POSOR
    scan: Scan  # the readings as a scan
    readings: FloatArray  # the readings [m], in the row order of the stack
    T_R_T: pin.SE3  # the pose


def read_cases(path: Path, stack: StackName) -> Iterator[Case]:
    """Read a file of cases for one of the stacks."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise DataFileError(f"cannot be read: {reason}", where=str(path), expected="one JSON case per line") from error
    for number, line in enumerate(lines, start=1):
        where = f"{path}, line {number}"
        try:
            yield _case(json.loads(line), stack)
        except json.JSONDecodeError as error:
            raise DataFileError(f"is not JSON: {error.msg}", where=where, expected="one case") from error
        except KeyError as error:
            raise DataFileError(f"key {error} is missing", where=where) from error
        except (TypeError, ValueError, IndexError, AttributeError) as error:
            raise DataFileError(f"is not a case: {error}", where=where, expected="one ray-traced case") from error
    if not lines:
        raise DataFileError("holds no case", where=str(path), expected="one JSON case per line")


def _case(case: dict[str, Any], stack: StackName) -> Case:
    gaps, spots, ring_gaps = (np.array(case["readings"][name]) for name in ("gaps", "spots", "ring_gaps"))
    with_ring = stack == "triad_bumpy_ring"
    content = {
        "format": "posor_calibration",
        "version": 1,
        "name": f"case {case['case']}",
        "provenance": {"source": "ray-traced case", "method": "exact", "date": "none"},
        "frames": {"parent": "receiving", "child": "target"},
        "sensors": [_gap_probes(case), _bumpy_ring(case) if with_ring else _diodes(case)],
    }
    calibration = calibration_from(content)
    currents = np.column_stack([1.0 + spots, 1.0 - spots]) * (_CURRENT / 2.0)
    scan = Scan(
        number=case["case"],
        gap_voltages=gaps,
        ring_voltages=ring_gaps if with_ring else np.empty(0),
        diode_currents=np.empty((0, 4)) if with_ring else currents,
        lit_sources=() if with_ring else tuple(range(len(spots))),
    )
    pose = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
    expected = np.concatenate([gaps, ring_gaps if with_ring else spots.ravel()])
    return Case(calibration.name, calibration, scan, expected, pose)


def _probes(kind: str, probes: list[dict[str, list[float]]]) -> list[dict[str, object]]:
    return [
        {
            "name": f"{kind} {i}",
            "tip": quantity_entry(probe["tip"], "m"),
            "axis": quantity_entry(probe["axis"], "1"),
            "volts_to_gap": quantity_entry([0.0, 1.0], "m/V^k"),
            "zero_shift": quantity_entry(0.0, "V"),
            "noise": quantity_entry(1e-7, "V"),
            "range": quantity_entry([-_GAP_SPAN, _GAP_SPAN], "V"),
        }
        for i, probe in enumerate(probes)
    ]


def _gap_probes(case: dict[str, Any]) -> dict[str, object]:
    plane, normal = case["target_plane"], case["target_plane"]["normal"]
    tilt = [math.atan2(normal[1], -normal[2]), math.asin(-normal[0])]
    return {
        "type": "gap_probes",
        "target_plane": {"point": quantity_entry(plane["point"], "m"), "tilt": quantity_entry(tilt, "rad")},
        "probes": _probes("gap", case["probes"]),
    }


def _diodes(case: dict[str, Any]) -> dict[str, object]:
    diodes = [
        {
            "name": f"diode {i}",
            "origin": quantity_entry(d["origin"], "m"),
            "x_axis": quantity_entry(d["u"], "1"),
            "y_axis": quantity_entry(d["v"], "1"),
            "noise": quantity_entry([1e-6, 1e-6], "1"),
            "minimum_sum": quantity_entry(1e-9, "A"),
        }
        for i, d in enumerate(case["diodes"])
    ]
    sources = [
        {
            "name": f"source {i}",
            "origin": quantity_entry(s["origin"], "m"),
            "direction": quantity_entry(s["direction"], "1"),
        }
        for i, s in enumerate(case["sources"])
    ]
    maps = {"identity": [_IDENTITY] * len(diodes)}
    return {"type": "diodes", "diodes": diodes, "light_sources": sources, "map": "identity", "maps": maps}


def _bumpy_ring(case: dict[str, Any]) -> dict[str, object]:
    ring = case["ring"]
    orders = sorted({int(k) for k in (*ring["cos"], *ring["sin"])})
    amplitudes = {name: [float(ring[name].get(str(k), 0.0)) for k in orders] for name in ("cos", "sin")}
    profile = {name: quantity_entry(values, "m") for name, values in amplitudes.items()}
    radius = quantity_entry(ring["mean_radius"], "m")
    return {
        "type": "bumpy_ring",
        "ring": {"bumps": ring["bumps"], "mean_radius": radius, "orders": orders, **profile},
        "home": quantity_entry(0.0, "rad"),
        "probes": _probes("ring", case["ring_probes"]),
    }


def case_errors(case: Case) -> tuple[float, float, float]:
    """Return the largest error of the predicted readings [m], and of the recovered translation [m] and angle [rad]."""
    posor = Posor(case.calibration)
    predicted = posor.predict(case.scan, case.T_R_T)
    # The bump count is taken as known: the true rotation about Z, rounded to a whole bump.
    bump = max(sensor.bump_angle for sensor in case.calibration.sensors)
    theta = math.atan2(case.T_R_T.rotation[1, 0], case.T_R_T.rotation[0, 0])
    counts = np.array([bump * round(theta / bump)]) if bump > 0.0 else None
    found = posor.estimate_each(Scans.of([case.scan]), counts)
    if found.states[0] != State.OK:
        raise DataFileError(f"gives no pose ({Fault(int(found.faults[0])).name})", where=case.name)
    error = case.T_R_T.inverse() * pin.SE3(found.rotations[0], found.translations[0])
    return (
        float(np.max(np.abs(predicted - case.readings))),
        float(np.linalg.norm(error.translation)),
        float(np.linalg.norm(pin.log3(error.rotation))),
    )


def largest_errors(path: Path) -> dict[str, dict[str, float]]:
    """Return the largest errors over all cases of a file, by stack.

    Raises DataFileError: the file cannot be read, or a case gives no pose.
    """
    report = {}
    for stack in get_args(StackName):
        largest = np.max([case_errors(case) for case in read_cases(path, stack)], axis=0)
        report[stack] = dict(zip(("prediction_m", "translation_m", "rotation_rad"), largest.tolist(), strict=True))
    return report


@reports_errors
def main(arguments: list[str] | None = None) -> int:
    """Run the check; the exit code is 0 if all cases could be checked."""
    parser = CommandLineParser(prog="golden", description=str(__doc__).splitlines()[0])
    parser.add_argument("file", type=Path, help="cases, one JSON object per line")
    print(json.dumps(largest_errors(parser.parse_args(arguments).file)))
    return 0

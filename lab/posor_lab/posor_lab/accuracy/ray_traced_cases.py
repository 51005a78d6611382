"""Ray-traced cases: geometry, pose and reading of each sensor, one JSON object per line.

Each case becomes a calibration whose linearisations are the identity (one volt is one metre, a current ratio of one is
one metre), so that its readings pass all steps of a scan.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.design_parts import quantity_entry
from posor.errors import DataFileError
from posor.model.scan import Scan

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

StackName = Literal["triad_diodes", "triad_bumpy_ring"]

_SPAN = 10.0
"""Half-width of the range of voltages [V] and ratios [1]: wider than any reading."""
_CURRENT = 1e-4


@dataclass(frozen=True)
class RayTracedCase:
    """One ray-traced case, for one stack of its sensors.

    Attributes:
        name: ``case <number>``.
        calibration: The POSOR.
        scan: The readings as a scan.
        readings: The readings [m], in the row order of the stack.
        T_R_T: The pose.

    """

    name: str
    calibration: Calibration
    scan: Scan
    readings: FloatArray
    T_R_T: pin.SE3


def read_cases(path: Path, stack: StackName) -> Iterator[RayTracedCase]:
    """Read a file of cases for one of the stacks.

    Raises:
        DataFileError: The file cannot be read, or a line is not a case.

    """
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


def _probe(name: str, tip: list[float], axis: list[float]) -> dict[str, object]:
    return {
        "name": name,
        "tip": quantity_entry(tip, "m"),
        "axis": quantity_entry(axis, "1"),
        "volts_to_gap": quantity_entry([0.0, 1.0], "m/V^k"),
        "zero_shift": quantity_entry(0.0, "V"),
        "noise": quantity_entry(1e-7, "V"),
        "range": quantity_entry([-_SPAN, _SPAN], "V"),
    }


def _gap_probes(case: dict[str, Any]) -> dict[str, object]:
    normal = case["target_plane"]["normal"]
    tilt = [math.atan2(normal[1], -normal[2]), math.asin(-normal[0])]
    return {
        "type": "gap_probes",
        "target_plane": {
            "point": quantity_entry(case["target_plane"]["point"], "m"),
            "tilt": quantity_entry(tilt, "rad"),
        },
        "probes": [_probe(f"gap {i}", p["tip"], p["axis"]) for i, p in enumerate(case["probes"])],
    }


def _diodes(case: dict[str, Any]) -> dict[str, object]:
    identity = {
        "kind": "polynomial",
        "center": quantity_entry([0.0, 0.0], "1"),
        "domain": quantity_entry([[-_SPAN, _SPAN], [-_SPAN, _SPAN]], "1"),
        "x": quantity_entry([[0.0, 0.0], [1.0, 0.0]], "m"),
        "y": quantity_entry([[0.0, 1.0], [0.0, 0.0]], "m"),
    }
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
    return {
        "type": "diodes",
        "diodes": diodes,
        "light_sources": sources,
        "map": "identity",
        "maps": {"identity": [identity] * len(diodes)},
    }


def _bumpy_ring(case: dict[str, Any]) -> dict[str, object]:
    ring = case["ring"]
    orders = sorted({int(k) for k in (*ring["cos"], *ring["sin"])})
    amplitudes = {name: [float(ring[name].get(str(k), 0.0)) for k in orders] for name in ("cos", "sin")}
    return {
        "type": "bumpy_ring",
        "ring": {
            "bumps": ring["bumps"],
            "mean_radius": quantity_entry(ring["mean_radius"], "m"),
            "orders": orders,
            "cos": quantity_entry(amplitudes["cos"], "m"),
            "sin": quantity_entry(amplitudes["sin"], "m"),
        },
        "home": quantity_entry(0.0, "rad"),
        "probes": [_probe(f"ring {i}", p["tip"], p["axis"]) for i, p in enumerate(case["ring_probes"])],
    }


def _case(case: dict[str, Any], stack: StackName) -> RayTracedCase:
    readings = case["readings"]
    gaps = np.array(readings["gaps"])
    spots = np.array(readings["spots"])
    with_ring = stack == "triad_bumpy_ring"
    currents = np.column_stack([1.0 + spots, 1.0 - spots]) * (_CURRENT / 2.0)
    ring_gaps = np.array(readings["ring_gaps"])
    calibration = calibration_from(
        {
            "format": "posor_calibration",
            "version": 1,
            "name": f"case {case['case']}",
            "provenance": {"source": "ray-traced case", "method": "exact", "date": "none"},
            "frames": {"parent": "receiving", "child": "target"},
            "sensors": [_gap_probes(case), _bumpy_ring(case) if with_ring else _diodes(case)],
        }
    )
    scan = Scan(
        number=case["case"],
        gap_voltages=gaps,
        ring_voltages=ring_gaps if with_ring else np.empty(0),
        diode_currents=np.empty((0, 4)) if with_ring else currents,
        lit_sources=() if with_ring else tuple(range(len(spots))),
    )
    pose = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
    expected = np.concatenate([gaps, ring_gaps if with_ring else spots.ravel()])
    return RayTracedCase(calibration.name, calibration, scan, expected, pose)

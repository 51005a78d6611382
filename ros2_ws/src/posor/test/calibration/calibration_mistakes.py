"""The mistakes that somebody can make in a calibration file, each with the sentence that names it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .calibration_content import DIODES, PROBE, SESSION, Key, drop, put, rename

if TYPE_CHECKING:
    from collections.abc import Callable

PLANE: Key = ("sensors", 0, "target_plane")


@dataclass(frozen=True)
class Wrong:
    """One mistake: the edit that makes it, the key that is to be named, and what is to be said."""

    edit: Callable[[Any], None]
    key: Key
    says: str


YES = True
BENT = [0.0, 0.1, 1.0]
FLAT = {"value": [1e-4, 0.0, -2e-3], "unit": "m/V^k"}

WRONG = {
    "unknown key": Wrong(put("red", "colour"), ("colour",), "unknown key 'colour'; expected a key of the format"),
    "misspelt key": Wrong(
        rename("tilt_angel", "tilt_angle"), ("tilt_angel",), "unknown key 'tilt_angel'; expected perhaps 'tilt_angle'"
    ),
    "misspelt key that must be there": Wrong(
        rename("nois", *PROBE, "noise"), (*PROBE, "nois"), "unknown key 'nois'; expected perhaps 'noise'"
    ),
    "misspelt key of a quantity": Wrong(
        rename("sgima", *PROBE, "tip", "sigma"),
        (*PROBE, "tip", "sgima"),
        "unknown key 'sgima'; expected perhaps 'sigma'",
    ),
    "key of another place": Wrong(
        rename("zero_shift", *SESSION, "zero_shifts"),
        (*SESSION, "zero_shift"),
        "unknown key 'zero_shift'; expected perhaps 'zero_shifts'",
    ),
    "misspelt key of a diode": Wrong(
        rename("y_axes", *DIODES, "diodes", 1, "y_axis"),
        (*DIODES, "diodes", 1, "y_axes"),
        "unknown key 'y_axes'; expected perhaps 'y_axis'",
    ),
    "missing key at the top": Wrong(drop("name"), (), "key 'name' is missing"),
    "missing key": Wrong(drop(*PROBE, "tip"), PROBE, "key 'tip' is missing"),
    "missing unit": Wrong(drop(*PROBE, "zero_shift", "unit"), (*PROBE, "zero_shift"), "key 'unit' is missing"),
    "missing sensors": Wrong(drop("sensors"), (), "key 'sensors' is missing"),
    "missing key of a session": Wrong(drop(*SESSION, "note"), SESSION, "key 'note' is missing"),
    "missing key of a map": Wrong(
        drop(*DIODES, "maps", "B", 1, "domain"), (*DIODES, "maps", "B", 1), "key 'domain' is missing"
    ),
    "missing version": Wrong(drop("version"), (), "key 'version' is missing; expected 1, 2 or 3"),
    "missing type": Wrong(
        drop(*DIODES, "type"),
        DIODES,
        "key 'type' is missing; expected one of 'bumpy_ring', 'diodes', 'gap_probes'",
    ),
    "wrong unit": Wrong(
        put("mV", *PROBE, "zero_shift", "unit"), (*PROBE, "zero_shift", "unit"), "unit 'mV'; expected 'V'"
    ),
    "inch": Wrong(
        put("in", *PLANE, "point", "unit"), (*PLANE, "point", "unit"), "unit 'in'; expected 'm', 'mm' or 'um'"
    ),
    "inches beside the number": Wrong(
        put("3 in", *PLANE, "point", "value", 0),
        (*PLANE, "point", "value", 0),
        "'3 in'; expected a number in 'm', 'mm' or 'um'",
    ),
    "angle for a length": Wrong(
        put("deg", *PLANE, "point", "unit"),
        (*PLANE, "point", "unit"),
        "unit 'rad' or 'deg'; expected 'm', 'mm' or 'um'",
    ),
    "wrong unit of a diode": Wrong(
        put("mA", *DIODES, "diodes", 0, "minimum_sum", "unit"),
        (*DIODES, "diodes", 0, "minimum_sum", "unit"),
        "unit 'mA'; expected 'A'",
    ),
    "two numbers for three": Wrong(
        put([0.0, 0.0], *PLANE, "point", "value"),
        (*PLANE, "point", "value"),
        "value has 2 numbers; expected 3 numbers",
    ),
    "list for one number": Wrong(
        put([0.0], *PROBE, "zero_shift", "value"),
        (*PROBE, "zero_shift", "value"),
        "value has one number in a list; expected one number",
    ),
    "one number for a list": Wrong(
        put(0.0, *PROBE, "tip", "value"), (*PROBE, "tip", "value"), "value has one number; expected 3 numbers"
    ),
    "list for a table": Wrong(
        put([0.0, 1.0], *DIODES, "maps", "A", 0, "domain", "value"),
        (*DIODES, "maps", "A", 0, "domain", "value"),
        "value has 2 numbers; expected a table of 2 x 2 numbers",
    ),
    "rows of different lengths": Wrong(
        put([[0.5, 0.6], [0.1]], *DIODES, "maps", "A", 0, "domain", "value"),
        (*DIODES, "maps", "A", 0, "domain", "value"),
        "rows of different lengths [[0.5, 0.6], [0.1]]; expected a rectangular array",
    ),
    "shape of sigma": Wrong(
        put([1e-6, 1e-6], *PROBE, "tip", "sigma"),
        (*PROBE, "tip", "sigma"),
        "sigma has 2 numbers; expected one number or 3 numbers",
    ),
    "word for a number": Wrong(
        put("small", *PROBE, "noise", "value"), (*PROBE, "noise", "value"), "'small'; expected a number"
    ),
    "word among numbers": Wrong(
        put([0.0, "wide", 0.0], *PROBE, "tip", "value"),
        (*PROBE, "tip", "value", 1),
        "'wide'; expected a number",
    ),
    "number in quotes": Wrong(
        put("0.25", *PROBE, "noise", "value"), (*PROBE, "noise", "value"), "'0.25'; expected a number"
    ),
    "truth for a number": Wrong(
        put(YES, *PROBE, "noise", "value"),
        (*PROBE, "noise", "value"),
        "True; expected a number",
    ),
    "nothing for a number": Wrong(
        put(None, *PROBE, "noise", "value"), (*PROBE, "noise", "value"), "None; expected a number"
    ),
    "number without a unit": Wrong(
        put(0.5, *PROBE, "zero_shift"),
        (*PROBE, "zero_shift"),
        "0.5 has no unit; expected a mapping such as {value: 1.0, unit: m}",
    ),
    "number for a word": Wrong(
        put(12, "name"), ("name",), "12; expected text, in quotes where YAML would read something else"
    ),
    "word for a list": Wrong(put("one", "provenance", "notes"), ("provenance", "notes"), "'one'; expected a list"),
    "mapping for a list": Wrong(put({"a": 1}, "sensors"), ("sensors",), "{'a': 1}; expected a list"),
    "list for a mapping": Wrong(put(["a"], "frames"), ("frames",), "['a']; expected a mapping"),
    "number for a sensor": Wrong(put(1, "sensors", 0), ("sensors", 0), "1; expected a mapping"),
    "no sensor": Wrong(put([], "sensors"), ("sensors",), "has 0 entries; expected at least 1"),
    "no probe": Wrong(put([], "sensors", 0, "probes"), ("sensors", 0, "probes"), "has 0 entries; expected at least 1"),
    "later version": Wrong(
        put(4, "version"),
        ("version",),
        "version 4; expected 1, 2 or 3, or a later release of this software, which reads version 4",
    ),
    "version in quotes": Wrong(put("1", "version"), ("version",), "version '1'; expected 1, 2 or 3"),
    "version with a fraction": Wrong(put(1.0, "version"), ("version",), "version 1.0; expected 1, 2 or 3"),
    "truth for a version": Wrong(put(YES, "version"), ("version",), "version True; expected 1, 2 or 3"),
    "wrong format": Wrong(
        put("robot_calibration", "format"), ("format",), "'robot_calibration'; expected 'posor_calibration'"
    ),
    "unknown choice": Wrong(
        put("last_scan", "tilt_angle"), ("tilt_angle",), "'last_scan'; expected 'this_scan' or 'previous_scan'"
    ),
    "not a number": Wrong(
        put(float("nan"), *PROBE, "noise", "value"),
        (*PROBE, "noise", "value"),
        "nan is not finite; expected finite numbers",
    ),
    "infinite": Wrong(
        put([0.0, float("-inf"), 0.0], *PROBE, "tip", "value"),
        (*PROBE, "tip", "value"),
        "[0.0, -inf, 0.0] is not finite; expected finite numbers",
    ),
    "sigma not a number": Wrong(
        put(float("nan"), *PROBE, "tip", "sigma"),
        (*PROBE, "tip", "sigma"),
        "nan is not finite; expected finite numbers",
    ),
    "negative sigma": Wrong(
        put([0.0, -1e-6, 0.0], *PROBE, "tip", "sigma"),
        (*PROBE, "tip", "sigma"),
        "[0.0, -1e-06, 0.0] is negative; expected a standard uncertainty of zero or more",
    ),
    "axis of another length": Wrong(
        put(BENT, *PROBE, "axis", "value"),
        (*PROBE, "axis"),
        "axis [0.0, 0.1, 1.0] has length 1.00498756; expected a unit vector",
    ),
    "axis of a diode of another length": Wrong(
        put(BENT, *DIODES, "diodes", 1, "y_axis", "value"),
        (*DIODES, "diodes", 1, "y_axis"),
        "y_axis [0.0, 0.1, 1.0] has length 1.00498756; expected a unit vector",
    ),
    "direction of another length": Wrong(
        put(BENT, *DIODES, "light_sources", 1, "direction", "value"),
        (*DIODES, "light_sources", 1, "direction"),
        "direction [0.0, 0.1, 1.0] has length 1.00498756; expected a unit vector",
    ),
    "parallel axes": Wrong(
        put([1.0, 0.0, 0.0], *DIODES, "diodes", 0, "y_axis", "value"),
        (*DIODES, "diodes", 0, "x_axis"),
        "x_axis and y_axis are nearly parallel (sine 0); expected axes near a right angle",
    ),
    "polynomial that turns back": Wrong(
        put(FLAT, *PROBE, "volts_to_gap"),
        (*PROBE, "volts_to_gap"),
        "volts_to_gap is not monotonic over the range [-0.6, 1.2] V; expected one gap for each voltage",
    ),
    "range upside down": Wrong(
        put([1.2, -0.6], *PROBE, "range", "value"),
        (*PROBE, "range"),
        "range [1.2, -0.6]; expected [lowest, highest] voltage",
    ),
    "no noise": Wrong(put(0.0, *PROBE, "noise", "value"), (*PROBE, "noise"), "noise 0.0; expected more than 0 V"),
    "unknown sensor type": Wrong(
        put("laser", "sensors", 0, "type"),
        ("sensors", 0, "type"),
        "type 'laser'; expected one of 'bumpy_ring', 'diodes', 'gap_probes'",
    ),
    "unknown set of maps": Wrong(put("C", *DIODES, "map"), (*DIODES, "map"), "map 'C'; expected one of A, B"),
    "a map for one diode only": Wrong(
        drop(*DIODES, "maps", "A", 1),
        (*DIODES, "maps", "A"),
        "maps.A has 1 maps; expected 2, one for each diode",
    ),
    "domain upside down": Wrong(
        put([[0.6, 0.5], [0.0, 0.1]], *DIODES, "maps", "A", 1, "domain", "value"),
        (*DIODES, "maps", "A", 1, "domain"),
        "domain [[0.6, 0.5], [0.0, 0.1]]; expected [lowest, highest] for each ratio",
    ),
    "one frame for two": Wrong(
        put("posor_receiving", "frames", "child"),
        ("frames", "child"),
        "child 'posor_receiving' is also the parent; expected two frames",
    ),
    "empty list": Wrong(
        put([], *PROBE, "volts_to_gap", "value"),
        (*PROBE, "volts_to_gap", "value"),
        "the list is empty; expected at least one number",
    ),
    "number beyond all floats": Wrong(
        put(10**309, *PROBE, "noise", "value"),
        (*PROBE, "noise", "value"),
        f"1{'0' * 17}...{'0' * 19} is not finite; expected finite numbers",
    ),
    "least current sum of zero": Wrong(
        put(0.0, *DIODES, "diodes", 0, "minimum_sum", "value"),
        (*DIODES, "diodes", 0, "minimum_sum"),
        "minimum_sum 0 A; expected more than 0 A",
    ),
    "greatest current sum below the least": Wrong(
        put({"value": 1e-6, "unit": "A"}, *DIODES, "diodes", 0, "maximum_sum"),
        (*DIODES, "diodes", 0, "maximum_sum"),
        "maximum_sum 1e-06 A; expected more than minimum_sum, 2e-05 A",
    ),
    "unknown kind of map": Wrong(
        put("spline", *DIODES, "maps", "A", 0, "kind"),
        (*DIODES, "maps", "A", 0, "kind"),
        "kind 'spline'; expected one of 'chebyshev', 'curves', 'polynomial'",
    ),
    "session without a name": Wrong(
        put({"note": "x"}, "sessions", ""),
        ("sessions",),
        "a session has an empty name; expected a name",
    ),
    "frame without a name": Wrong(
        put("", "frames", "parent"), ("frames", "parent"), "parent is empty; expected the name of a frame"
    ),
}

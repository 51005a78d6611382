"""What calibration files say, and the one sentence for each way in which they can be wrong."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.calibration.model import TiltAngle, calibration_from
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


Key = tuple[str | int, ...]

RIG = ("printed", "section84")
PROBE: Key = ("sensors", 0, "probes", 0)
PLANE: Key = ("sensors", 0, "target_plane")
DIODES: Key = ("sensors", 1)
SESSION: Key = ("sessions", "ymo")


def at(content: Any, key: Key) -> Any:
    for part in key:
        content = content[part]
    return content


def put(value: Any, *key: str | int) -> Callable[[Any], None]:
    def edit(content: Any) -> None:
        at(content, key[:-1])[key[-1]] = value

    return edit


def drop(*key: str | int) -> Callable[[Any], None]:
    def edit(content: Any) -> None:
        del at(content, key[:-1])[key[-1]]

    return edit


def rename(new: str, *key: str | int) -> Callable[[Any], None]:
    """Return the edit that gives a key another name and leaves it where it is."""

    def edit(content: Any) -> None:
        mapping = at(content, key[:-1])
        entries = [(new if name == key[-1] else name, value) for name, value in mapping.items()]
        mapping.clear()
        mapping.update(entries)

    return edit


def line_of(text: str, key: Key) -> int:
    """Return the line in which a key (or an entry of a list) begins."""
    node: Any = yaml.compose(text)
    line = 1
    for part in key:
        if isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            [(name, node)] = [entry for entry in node.value if entry[0].value == part]
            line = name.start_mark.line + 1
    return line


def written(key: Key) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


@pytest.fixture
def content(rig_calibrations: dict[str, Path]) -> dict[str, Any]:
    """What the rig's file says, as plain data."""
    return dict(yaml.safe_load(rig_calibrations["printed"].read_text(encoding="utf-8")))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "rig.yaml"


def write(file: Path, content: Any) -> str:
    text = yaml.safe_dump(content, sort_keys=False)
    file.write_text(text, encoding="utf-8")
    return text


def refusal(file: Path) -> str:
    with pytest.raises(CalibrationError) as caught:
        load_calibration(file)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert sentence.endswith(".")
    return sentence


@pytest.mark.parametrize("name", RIG)
def test_the_files_of_the_1985_rig_are_calibrations(name: str, rig_calibrations: dict[str, Path]) -> None:
    calibration = load_calibration(rig_calibrations[name])
    assert calibration.name == f"slocum1985_{name}"
    assert (calibration.frames.parent, calibration.frames.child) == ("posor_receiving", "posor_target")
    assert calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN
    assert [sensor.type for sensor in calibration.sensors] == ["gap_probes", "diodes"]  # type: ignore[attr-defined]
    assert set(calibration.sessions) == {"ymo", "yzmo", "zmo"}
    assert "MIT, 1985" in calibration.provenance.source
    assert len(calibration.provenance.notes) > 1


def test_quantities_keep_value_unit_and_uncertainty(rig_calibrations: dict[str, Path], content: Any) -> None:
    calibration = load_calibration(rig_calibrations["printed"])
    tip = calibration.sensors[0].probes[0].tip  # type: ignore[attr-defined]
    said = at(content, (*PROBE, "tip"))
    assert (tip.array.tolist(), tip.sigmas.tolist(), tip.unit) == (said["value"], said["sigma"], said["unit"])
    axis = calibration.sensors[0].probes[0].axis  # type: ignore[attr-defined]
    assert axis.sigmas.tolist() == [0.0, 0.0, 0.0]


def test_arrays_of_a_calibration_cannot_be_written_to(rig_calibrations: dict[str, Path]) -> None:
    tip = load_calibration(rig_calibrations["printed"]).sensors[0].probes[0].tip  # type: ignore[attr-defined]
    for array in (tip.array, tip.sigmas):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_one_sigma_counts_for_each_component(content: Any, file: Path) -> None:
    at(content, (*PROBE, "tip"))["sigma"] = 2e-6
    write(file, content)
    tip = load_calibration(file).sensors[0].probes[0].tip  # type: ignore[attr-defined]
    assert tip.sigmas.tolist() == [2e-6, 2e-6, 2e-6]


# What identifies a calibration.


def test_the_content_hash_does_not_see_layout_comments_or_order(
    rig_calibrations: dict[str, Path], content: dict[str, Any], file: Path
) -> None:
    original = load_calibration(rig_calibrations["printed"]).content_hash
    assert len(original) == 64
    assert set(original) <= set("0123456789abcdef")
    text = yaml.safe_dump(content, sort_keys=True, default_flow_style=True, width=40)
    file.write_text(f"# another layout\n{text}\n# the end\n", encoding="utf-8")
    assert load_calibration(file).content_hash == original
    file.write_text(rig_calibrations["printed"].read_text(encoding="utf-8").replace("\n", "\r\n"), encoding="utf-8")
    assert load_calibration(file).content_hash == original
    at(content, (*PROBE, "axis"))["value"] = [0, 0, 1]  # whole numbers are numbers
    write(file, content)
    assert load_calibration(file).content_hash == original


def test_the_files_of_the_1985_rig_have_different_hashes(rig_calibrations: dict[str, Path]) -> None:
    assert len({load_calibration(rig_calibrations[name]).content_hash for name in RIG}) == len(RIG)


def numbers(content: Any, key: Key = ()) -> list[Key]:
    """Return the key of every number in the content."""
    if isinstance(content, dict):
        return [found for name, value in content.items() for found in numbers(value, (*key, name))]
    if isinstance(content, list):
        return [found for i, value in enumerate(content) for found in numbers(value, (*key, i))]
    return [key] if isinstance(content, float) else []


def test_the_content_hash_depends_on_every_number(content: Any) -> None:
    seen = {calibration_from(content).content_hash}
    every = numbers(content)
    assert len(every) > 150
    for key in every:
        changed = copy.deepcopy(content)
        value = at(changed, key)
        # One part in 1e9, which unit vectors and limits forgive.
        put(value * (1.0 + 1e-9) if value else 1e-12, *key)(changed)
        digest = calibration_from(changed).content_hash
        assert digest not in seen, written(key)
        seen.add(digest)


@pytest.mark.parametrize(
    "key",
    [("name",), ("provenance", "source"), ("provenance", "notes", 0), ("frames", "child"), (*PROBE, "name")],
    ids=written,
)
def test_the_content_hash_depends_on_the_words(key: Key, content: Any, file: Path) -> None:
    write(file, content)
    before = load_calibration(file).content_hash
    put(at(content, key) + " x", *key)(content)
    write(file, content)
    assert load_calibration(file).content_hash != before


# Sessions.


def zero_shifts(calibration: Any) -> list[float]:
    return [probe.zero_shift.number for probe in calibration.sensors[0].probes]


def test_a_session_replaces_zero_shifts_and_maps(rig_calibrations: dict[str, Path]) -> None:
    whole = load_calibration(rig_calibrations["section84"])
    yzmo, zmo = whole.for_session("yzmo"), whole.for_session("zmo")
    assert zero_shifts(yzmo) == [-0.06, 0.18, 0.14]
    assert zero_shifts(zmo) == [0.0, 0.2, 0.3]
    assert [calibration.sensors[1].map for calibration in (yzmo, zmo)] == ["B", "A"]  # type: ignore[attr-defined]
    # The rest stands, and so does the calibration that the session was taken from.
    assert yzmo.sensors[0].probes[0].tip == whole.sensors[0].probes[0].tip  # type: ignore[attr-defined]
    assert zero_shifts(whole) == [0.0, 0.2, 0.3]


def test_a_session_leaves_what_it_does_not_name(content: Any, file: Path) -> None:
    put({"note": "nothing new"}, *SESSION)(content)
    write(file, content)
    whole = load_calibration(file)
    assert whole.for_session("ymo").sensors == whole.sensors


def test_the_empty_session_is_the_calibration_itself(rig_calibrations: dict[str, Path]) -> None:
    whole = load_calibration(rig_calibrations["printed"])
    assert whole.for_session("") is whole


def test_each_session_has_a_hash_of_its_own(rig_calibrations: dict[str, Path]) -> None:
    whole = load_calibration(rig_calibrations["section84"])
    assert len({whole.for_session(name).content_hash for name in ("", "ymo", "yzmo", "zmo")}) == 4


def test_the_uncertainty_of_a_zero_shift_comes_from_the_session(content: Any, file: Path) -> None:
    put({"value": [0.1, 0.2, 0.3], "sigma": [0.01, 0.02, 0.03], "unit": "V"}, *SESSION, "zero_shifts")(content)
    write(file, content)
    probes = load_calibration(file).for_session("ymo").sensors[0].probes  # type: ignore[attr-defined]
    assert [float(probe.zero_shift.sigmas) for probe in probes] == [0.01, 0.02, 0.03]


def test_an_unknown_session_is_refused(rig_calibrations: dict[str, Path]) -> None:
    with pytest.raises(CalibrationError) as caught:
        load_calibration(rig_calibrations["printed"]).for_session("ymx")
    assert str(caught.value) == ("calibration 'slocum1985_printed': session 'ymx' is unknown; expected ymo, yzmo, zmo.")


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (put([0.0, 0.2], *SESSION, "zero_shifts", "value"), "2 values; expected 3, one for each gap probe."),
        (put("C", *SESSION, "diode_map"), "'C'; expected one of A, B."),
    ],
    ids=["number of zero shifts", "unknown map"],
)
def test_a_session_that_does_not_fit_is_refused(
    edit: Callable[[Any], None], says: str, content: Any, file: Path
) -> None:
    edit(content)
    write(file, content)
    with pytest.raises(CalibrationError) as caught:
        load_calibration(file).for_session("ymo")
    assert str(caught.value).endswith(says)


# Every way to be wrong.


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
        rename("tilt_angel", "tilt_angle"), ("tilt_angel",), "unknown key 'tilt_angel'; expected 'tilt_angle'"
    ),
    "misspelt key that must be there": Wrong(
        rename("nois", *PROBE, "noise"), (*PROBE, "nois"), "unknown key 'nois'; expected 'noise'"
    ),
    "misspelt key of a quantity": Wrong(
        rename("sgima", *PROBE, "tip", "sigma"), (*PROBE, "tip", "sgima"), "unknown key 'sgima'; expected 'sigma'"
    ),
    "key of another place": Wrong(
        rename("zero_shift", *SESSION, "zero_shifts"),
        (*SESSION, "zero_shift"),
        "unknown key 'zero_shift'; expected 'zero_shifts'",
    ),
    "misspelt key of a diode": Wrong(
        rename("y_axes", *DIODES, "diodes", 1, "y_axis"),
        (*DIODES, "diodes", 1, "y_axes"),
        "unknown key 'y_axes'; expected 'y_axis'",
    ),
    "missing key at the top": Wrong(drop("name"), (), "key 'name' is missing"),
    "missing key": Wrong(drop(*PROBE, "tip"), PROBE, "key 'tip' is missing"),
    "missing unit": Wrong(drop(*PROBE, "zero_shift", "unit"), (*PROBE, "zero_shift"), "key 'unit' is missing"),
    "missing sensors": Wrong(drop("sensors"), (), "key 'sensors' is missing"),
    "missing key of a session": Wrong(drop(*SESSION, "note"), SESSION, "key 'note' is missing"),
    "missing key of a map": Wrong(
        drop(*DIODES, "maps", "B", 1, "domain"), (*DIODES, "maps", "B", 1), "key 'domain' is missing"
    ),
    "missing version": Wrong(drop("version"), (), "key 'version' is missing; expected 1 or 2"),
    "missing type": Wrong(drop(*DIODES, "type"), DIODES, "key 'type' is missing"),
    "wrong unit": Wrong(
        put("mV", *PROBE, "zero_shift", "unit"), (*PROBE, "zero_shift", "unit"), "unit 'mV'; expected 'V'"
    ),
    "inch": Wrong(put("in", *PLANE, "point", "unit"), (*PLANE, "point", "unit"), "unit 'in'; expected 'm'"),
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
        put(12, "name"), ("name",), "12; expected text, in quotes where YAML would take it for something else"
    ),
    "word for a list": Wrong(put("one", "provenance", "notes"), ("provenance", "notes"), "'one'; expected a list"),
    "mapping for a list": Wrong(put({"a": 1}, "sensors"), ("sensors",), "{'a': 1}; expected a list"),
    "list for a mapping": Wrong(put(["a"], "frames"), ("frames",), "['a']; expected a mapping"),
    "number for a sensor": Wrong(put(1, "sensors", 0), ("sensors", 0), "1; expected a mapping"),
    "no sensor": Wrong(put([], "sensors"), ("sensors",), "has 0 entries; expected at least 1"),
    "no probe": Wrong(put([], "sensors", 0, "probes"), ("sensors", 0, "probes"), "has 0 entries; expected at least 1"),
    "later version": Wrong(put(3, "version"), ("version",), "version 3; expected 1 or 2"),
    "version in quotes": Wrong(put("1", "version"), ("version",), "version '1'; expected 1 or 2"),
    "version with a fraction": Wrong(put(1.0, "version"), ("version",), "version 1.0; expected 1 or 2"),
    "truth for a version": Wrong(put(YES, "version"), ("version",), "version True; expected 1 or 2"),
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
        "child 'posor_receiving' is the parent too; expected two frames",
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
        "a session has no name; expected a name, by which it can be chosen",
    ),
    "frame without a name": Wrong(
        put("", "frames", "parent"), ("frames", "parent"), "parent is empty; expected the name of a frame"
    ),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_named_with_file_line_key_and_what_is_expected(mistake: str, content: Any, file: Path) -> None:
    wrong = WRONG[mistake]
    wrong.edit(content)
    text = write(file, content)
    key = f", key {written(wrong.key)}" if wrong.key else ""
    line = line_of(text, wrong.key)
    assert refusal(file) == f"{file}, line {line}{key}: {wrong.says}."


@pytest.mark.parametrize("where", [(), ("sessions",), PROBE], ids=["top", "sessions", "probe"])
def test_a_key_that_is_no_text_is_refused(where: Key, content: Any, file: Path) -> None:
    """A session of the year 1985, say, needs quotes."""
    put({"note": "x"}, *where, 1985)(content)
    lines = write(file, content).splitlines()
    [line] = [number for number, text in enumerate(lines, 1) if text.strip() == "1985:"]
    assert refusal(file) == (
        f"{file}, line {line}, key {written((*where, '1985'))}: key 1985 is not text; "
        "expected text, in quotes where YAML would take it for something else."
    )


def test_of_several_mistakes_one_is_named(content: Any, file: Path) -> None:
    put("mV", *PROBE, "noise", "unit")(content)
    drop(*PROBE, "tip")(content)
    put("C", *DIODES, "map")(content)
    write(file, content)
    assert refusal(file).startswith(f"{file}, line ")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        ("# a comment\n", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        ("- 1\n- 2\n", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        ("just text\n", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        (
            "format: [posor_calibration\nversion: 1\n",
            "line 2: is not YAML: while parsing a flow sequence, expected ',' or ']', but got ':'.",
        ),
        (
            "format: x\nversion:\n\t1\n",
            (
                "line 3: is not YAML: while scanning for the next token, "
                "found character '\\t' that cannot start any token."
            ),
        ),
        (
            "version: 1\n---\nversion: 1\n",
            "line 2: is not YAML: expected a single document in the stream, but found another document.",
        ),
        ("format: x\nversion: 1\nname: a\x00b\n", "line 3: is not YAML: it holds the control character 0x00."),
        ("format: x\nformat: y\n", "line 2: is not YAML: key 'format' stands here and in line 1."),
        ("version: 1\nname: &a [*a]\n", "line 2: is not YAML: alias 'a' stands inside what it names."),
        ("version: !!bool maybe\n", "line 1: is not YAML: 'maybe' does not fit the tag tag:yaml.org,2002:bool."),
        ("name: !!python/name:os.system\n", "line 1: is not YAML: could not determine a constructor for the tag"),
        ("? [a, b]\n: c\n", "line 1: is not YAML: while constructing a mapping, found unhashable key."),
        ("date: 2020-99-99\n", "line 1: is not YAML: month must be in 1..12."),
        ("[" * 5000, "line 1: is not YAML: it is nested too deeply."),
    ],
    ids=[
        *("empty", "comment only", "list", "text", "open bracket", "tab", "two documents", "control character"),
        *("key twice", "endless", "text that its tag does not allow", "Python object", "list as a key"),
        *("impossible date", "very deep"),
    ],
)
def test_what_is_no_yaml_or_no_mapping_is_refused(text: str, says: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    sentence = refusal(file)
    assert sentence.startswith(f"{file}")
    assert says in sentence


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("name: slocum1985_printed\n", "name: another\n"),
        ("zero_shift: {value: 0.0, unit: V}\n", "zero_shift: {value: 9.0, unit: V}\n"),
    ],
    ids=["at the top", "in a probe"],
)
def test_a_key_that_stands_twice_is_refused(key: str, text: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    """YAML readers take the last one without a word: the first may be the one that its author looks at."""
    original = rig_calibrations["printed"].read_text(encoding="utf-8")
    before, line, after = original.partition(key)
    assert line
    indent = before.rpartition("\n")[2]
    file.write_text(before + line + indent + text + after, encoding="utf-8")
    first = before.count("\n") + 1
    name = key.partition(":")[0]
    assert refusal(file) == f"{file}, line {first + 1}: is not YAML: key '{name}' stands here and in line {first}."


@pytest.mark.parametrize("number", ["010", "1:30", "0x1F", "1_000", "1e5e"])
def test_a_number_that_yaml_would_read_otherwise_than_it_looks_is_refused(
    number: str, rig_calibrations: dict[str, Path], file: Path
) -> None:
    """YAML 1.1 reads 010 as 8 and 1:30 as 90."""
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    shift = "zero_shift: {value: 0.0, unit: V}"
    line = text.partition(shift)[0].count("\n") + 1
    file.write_text(text.replace(shift, f"zero_shift: {{value: {number}, unit: V}}", 1), encoding="utf-8")
    key = written((*PROBE, "zero_shift", "value"))
    assert refusal(file) == f"{file}, line {line}, key {key}: '{number}'; expected a number."


@pytest.mark.parametrize("number", ["1", "+1", "1.", "1.0", "1e0", "0.1e+1", "10E-1", ".1e1"])
def test_a_decimal_may_be_written_in_any_way(number: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    shift = "zero_shift: {value: 0.0, unit: V}"
    file.write_text(text.replace(shift, f"zero_shift: {{value: {number}, unit: V}}", 1), encoding="utf-8")
    assert zero_shifts(load_calibration(file))[0] == 1.0


def test_an_anchor_gives_one_value_to_several_keys(rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    span = "range: {value: [-0.6, 1.2], unit: V}"
    assert text.count(span) > 1
    first, _, rest = text.partition(span)
    named = first + "range: &span {value: [-0.6, 1.2], unit: V}" + rest.replace(span, "range: *span")
    file.write_text(named, encoding="utf-8")
    assert load_calibration(file).content_hash == load_calibration(rig_calibrations["printed"]).content_hash


def test_a_power_of_ten_without_a_point_is_a_number(content: Any, file: Path) -> None:
    text = write(file, content).replace("value: 2.0e-05", "value: 2e-5")
    assert "value: 2e-5" in text
    file.write_text(text, encoding="utf-8")
    assert load_calibration(file).sensors[1].diodes[0].minimum_sum.number == 2e-5  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "rubbish",
    [bytes(range(256)), b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "format: posor_calibration\n".encode("utf-16")],
    ids=["every byte", "a picture", "UTF-16"],
)
def test_binary_rubbish_is_refused(rubbish: bytes, file: Path) -> None:
    file.write_bytes(rubbish)
    assert refusal(file) == (
        f"calibration file {file}: cannot be read: not UTF-8 text; expected a YAML calibration file."
    )


def test_a_byte_order_mark_is_no_mistake(rig_calibrations: dict[str, Path], file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + rig_calibrations["printed"].read_bytes())
    assert load_calibration(file).content_hash == load_calibration(rig_calibrations["printed"]).content_hash


def test_a_missing_file_is_refused(file: Path) -> None:
    assert refusal(file) == (
        f"calibration file {file}: cannot be read: No such file or directory; expected a YAML calibration file."
    )


def test_a_folder_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path) == (
        f"calibration file {tmp_path}: cannot be read: Is a directory; expected a YAML calibration file."
    )


def test_errors_keep_their_parts(content: Any, file: Path) -> None:
    put("mV", *PROBE, "zero_shift", "unit")(content)
    write(file, content)
    with pytest.raises(CalibrationError) as caught:
        load_calibration(file)
    error = caught.value
    assert (error.what, error.expected) == ("unit 'mV'", "'V'")
    assert error.where.startswith(f"{file}, line ")

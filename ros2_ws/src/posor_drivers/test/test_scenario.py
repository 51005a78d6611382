from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import yaml
from posor_drivers.simulator.phases import Circle, Dither, Rest, Spline
from posor_drivers.simulator.scenario import load_scenario
from posor_estimator.errors import CalibrationError

from .arms import SCENARIO, scenario

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SECONDS = {"unit": "s"}


def load(folder: Path, content: object) -> Any:
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return load_scenario(path)


def test_scenario_is_read_as_written() -> None:
    read = load_scenario(SCENARIO)
    assert (read.seed, read.ticks_per_second, read.cycle_ticks) == (1985, 100, 800)
    assert [type(phase) for phase in read.motion] == [Rest, Spline, Dither, Circle]
    assert read.joints["base"].gear is not None
    assert read.joints["base"].gear.backlash.number == 4e-5
    assert read.joints["base"].start.number == 0.0
    assert read.payload.mass.number == 3.0
    assert read.stage is not None
    assert read.stage.command_age.number == 0.5
    assert read.electronics.contamination[0].begin.number == 1.0


def test_what_is_left_out_is_perfect(tmp_path: Path) -> None:
    content = scenario()
    del content["stage"], content["payload"]
    content["joints"]["elbow"] = {}
    content["electronics"] = {"converter": content["electronics"]["converter"]}
    read = load(tmp_path, content)
    assert read.stage is None
    assert read.payload.mass.number == 0.0
    assert read.joints["elbow"].structure is None
    assert read.electronics.latency is None


def change(*path: str | int, to: object) -> Callable[[dict[str, Any]], None]:
    def apply(content: dict[str, Any]) -> None:
        part: Any = content
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = to

    return apply


def without(*path: str | int) -> Callable[[dict[str, Any]], None]:
    def apply(content: dict[str, Any]) -> None:
        part: Any = content
        for key in path[:-1]:
            part = part[key]
        del part[path[-1]]

    return apply


def value(number: object, unit: str) -> dict[str, object]:
    return {"value": number, "unit": unit}


ELECTRONICS = ("electronics",)
WRONG = {
    "rate": (change("rate", to=value(99.5, "Hz")), "key rate.value", "rate 99.5 Hz", "a whole number from 1 to 10000"),
    "rate unit": (change("rate", to=value(100, "kHz")), "key rate.unit", "unit 'kHz'", "'Hz'"),
    "duration": (
        change("duration", to=value(8.005, "s")),
        "key duration.value",
        "duration 8.005 s",
        "a whole number of ticks of 0.01 s",
    ),
    "phases": (
        change("motion", 0, "duration", to=value(0.5, "s")),
        "key motion",
        "the phases take 8.1 s",
        "8 s, the duration of the scenario",
    ),
    "end": (
        change("motion", 1, "through", "value", to=[[0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.25]]),
        "key motion[1].through",
        "the motion ends with joint 'elbow' at 0.25 rad",
        "0 rad, where it begins",
    ),
    "start": (
        change("joints", "base", "start", to=value(0.1, "rad")),
        "key motion[1].through",
        "the motion ends with joint 'base' at 0 rad",
        "0.1 rad, where it begins",
    ),
    "joint": (
        change("motion", 2, "joints", to=["base", "knee", "elbow"]),
        "key motion[2].joints[1]",
        "joint 'knee'",
        "one of base, shoulder, elbow",
    ),
    "joint twice": (
        change("motion", 1, "joints", to=["base", "base", "elbow"]),
        "key motion[1].joints[1]",
        "joint 'base' stands twice",
        "each joint once",
    ),
    "columns": (
        change("motion", 1, "joints", to=["base", "elbow"]),
        "key motion[1].through.value",
        "through has 3 numbers",
        "2, one for each joint",
    ),
    "times": (
        change("motion", 1, "at", "value", to=[1.0, 0.9, 3.2]),
        "key motion[1].at.value",
        "at [1.0, 0.9, 3.2] s",
        "ascending times from more than 0 s to 3.2 s, the duration",
    ),
    "last time": (
        change("motion", 1, "at", "value", to=[1.0, 2.0, 3.0]),
        "key motion[1].at.value",
        "at [1.0, 2.0, 3.0] s",
        "ascending times from more than 0 s to 3.2 s, the duration",
    ),
    "sines": (
        change("motion", 2, "frequency", "value", to=[3.0, 7.0]),
        "key motion[2].frequency.value",
        "frequency has 2 numbers",
        "3, one for each entry of joints",
    ),
    "phase": (
        change("motion", 0, "kind", to="jump"),
        "key motion[0].kind",
        "kind 'jump'",
        "one of 'circle', 'dither', 'rest', 'spline'",
    ),
    "axis": (
        change("motion", 3, "axis", "value", to=[0.0, 0.0, 2.0]),
        "key motion[3].axis",
        "axis [0.0, 0.0, 2.0] has length 2",
        "a unit vector",
    ),
    "approach": (
        change("motion", 3, "approach", "value", to=1.75),
        "key motion[3].approach.value",
        "approach 1.75 s",
        "less than 1.75 s, half the duration",
    ),
    "posture": (
        without("motion", 3, "posture"),
        "key motion[3].joints",
        "joints and posture do not go together",
        "both or neither",
    ),
    "bearing": (
        change("joints", "elbow", "bearing", "tilt", "value", to=[1e-5]),
        "key joints.elbow.bearing.tilt.value",
        "tilt has 1 amplitudes",
        "2, one for each of orders",
    ),
    "backlash": (
        change("joints", "elbow", "gear", "backlash", "value", to=-1e-5),
        "key joints.elbow.gear.backlash.value",
        "-1e-05 rad",
        "0 or more",
    ),
    "resolution": (
        change("joints", "elbow", "encoder", "resolution", "value", to=0.0),
        "key joints.elbow.encoder.resolution.value",
        "0.0 rad",
        "more than 0",
    ),
    "tube": (
        change("joints", "elbow", "structure", "inner_diameter", "value", to=0.2),
        "key joints.elbow.structure.inner_diameter",
        "inner_diameter 0.2 m",
        "0 to less than 0.12 m, the outer",
    ),
    "misspelt": (
        change("joints", "elbow", "gears", to={}),
        "key joints.elbow.gears",
        "unknown key 'gears'",
        "a key of the format",
    ),
    "bits": (change(*ELECTRONICS, "converter", "bits", to=18), "key electronics.converter.bits", "18", "at most 16"),
    "range": (
        change(*ELECTRONICS, "converter", "probes", "value", to=[5.0, -5.0]),
        "key electronics.converter.probes.value",
        "[5.0, -5.0] V",
        "[lowest, highest]",
    ),
    "dirt joint": (
        change(*ELECTRONICS, "contamination", 0, "joint", to="knee"),
        "key electronics.contamination[0].joint",
        "joint 'knee'",
        "one of base, shoulder, elbow",
    ),
    "dirt time": (
        change(*ELECTRONICS, "contamination", 0, "until", "value", to=1.0),
        "key electronics.contamination[0].until.value",
        "until 1 s",
        "more than 1 s, where it begins",
    ),
    "dirt beyond": (
        change(*ELECTRONICS, "contamination", 0, "until", "value", to=9.0),
        "key electronics.contamination[0].until.value",
        "until 9 s",
        "at most 8 s, the duration of the scenario",
    ),
    "dirt unit": (
        change(*ELECTRONICS, "contamination", 1, "size", "unit", to="V"),
        "key electronics.contamination[1].size",
        "size -0.05 'V'",
        "one number, unit '1'",
    ),
    "dirt size": (
        change(*ELECTRONICS, "contamination", 1, "size", "value", to=-1.0),
        "key electronics.contamination[1].size.value",
        "size -1",
        "more than -1, where no current is left",
    ),
    "dropouts": (
        change(*ELECTRONICS, "dropouts", "probability", "value", to=1.0),
        "key electronics.dropouts.probability.value",
        "1.0",
        "a probability of 0 or more, less than 1",
    ),
    "latency": (
        change(*ELECTRONICS, "latency", "jitter", "value", to=0.1),
        "key electronics.latency.jitter.value",
        "jitter 0.1 s",
        "at most 0.001 s, the mean",
    ),
    "measured": (
        change(*ELECTRONICS, "supply", "measured", to="yes"),
        "key electronics.supply.measured",
        "'yes'",
        "true or false",
    ),
    "converter": (
        without(*ELECTRONICS, "converter"),
        "key electronics",
        "key 'converter' is missing",
        "",
    ),
    "stroke": (change("stage", "stroke", "value", to=0.0), "key stage.stroke.value", "0.0 m", "more than 0"),
    "seed": (change("seed", to=-1), "key seed", "-1", "at least 0"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_is_refused_with_file_line_and_key(tmp_path: Path, name: str) -> None:
    apply, where, what, expected = WRONG[name]
    content = scenario()
    apply(content)
    with pytest.raises(CalibrationError) as refused:
        load(tmp_path, content)
    error = refused.value
    assert error.where.startswith(f"{tmp_path / 'scenario.yaml'}, line ")
    assert error.where.endswith(where)
    assert (error.what, error.expected) == (what, expected)

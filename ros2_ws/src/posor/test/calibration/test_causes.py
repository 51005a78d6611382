# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Causes of faults in a calibration file: defaults, replacements, and sentences on invalid entries."""

from __future__ import annotations

import math
from typing import Any

import pytest
import yaml
from posor.calibration.calibration_file import calibration_from, parse_calibration
from posor.calibration.causes import DEFAULT_CAUSES, FALSE_ALARM, MAX_CAUSES, MOVES, Cause
from posor.calibration.designs import DesignName, design
from posor.errors import CalibrationError
from posor.estimation.posor import Posor
from posor.node_parameters import ChainParameters, PosorParameters
from posor_lab.harness.case_tables import refusal

VALID: dict[str, Any] = {
    "name": "reference",
    "moves": "all gap probes",
    "unit": "1",
    "bound": 1e-5,
    "source": "data sheet",
}
INVALID: dict[
    str, tuple[dict[str, Any], str, str, str]
] = {  # changes of VALID, the key that the sentence names, what it says, what would be right
    "moves": ({"moves": "all gap prob"}, "moves", "moves 'all gap prob'", "'all gap probes'"),
    "unit": ({"unit": "K"}, "unit", "unit 'K' of 'all gap probes'", "'m' or 'V' or '1'"),
    "negative": ({"bound": -1e-5}, "bound", "bound -1e-05", "zero or more"),
    "infinite": ({"bound": math.inf}, "bound", "bound inf", "zero or more"),
    "both": ({"unlimited": True}, "causes.0", "both bound and unlimited", "'unlimited: true'"),
    "neither": ({"bound": None}, "causes.0", "neither bound nor unlimited", "'unlimited: true'"),
    "kind": ({"kind": "rare"}, "kind", "'rare'", "'fault' or 'always'"),
    "always": ({"bound": None, "unlimited": True, "kind": "always"}, "unlimited", "kind 'always'", "a bound"),
    "source": ({"source": " "}, "source", "source is empty", "'assumed'"),
    "name": ({"name": "n" * 65}, "name", "name 'n", "1 to 64 characters"),
    "shared": ({"shared_by": "all"}, "shared_by", "'all'", "'joint' or 'arm'"),
}
"""Changes of VALID, the key that the sentence names, what the sentence says is wrong, and what would be right."""


def content(*causes: dict[str, Any]) -> dict[str, Any]:
    return {**design("quad_diodes").model_dump(mode="json", exclude_none=True), "causes": list(causes)}


@pytest.mark.parametrize("case", INVALID)
def test_invalid_entries_are_named_with_what_is_right(case: str) -> None:
    change, key, what, expected = INVALID[case]
    entry = {name: value for name, value in (VALID | change).items() if value is not None}
    text = yaml.safe_dump(content(entry), sort_keys=False)
    with pytest.raises(CalibrationError) as caught:
        parse_calibration(text, "posor.yaml")
    sentence = str(caught.value)
    line = next(n for n, each in enumerate(text.splitlines(), 1) if each.startswith("causes"))
    assert sentence.startswith("posor.yaml, line ")
    assert int(sentence.split("line ")[1].split(",", maxsplit=1)[0]) > line
    for part in (key.split(".")[0], what, expected):
        assert part in sentence


def test_two_causes_of_one_name_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"a second cause 'reference'; expected different names"):
        parse_calibration(yaml.safe_dump(content(VALID, VALID)), "posor.yaml")


def test_an_entry_replaces_the_default_of_its_name_and_zero_removes_it() -> None:
    wedge = {**VALID, "name": "wedge of gaps", "moves": "gradient of gaps", "unit": "m", "bound": 2e-6}
    causes = Posor(calibration_from(content(VALID, wedge, {**wedge, "name": "light spots", "bound": 0.0}))).hypotheses
    found = {cause.name: cause for cause in causes.causes}
    assert found["wedge of gaps"].bound == 2e-6
    assert found["reference"].source == "data sheet"
    assert "light spots" not in found


@pytest.mark.parametrize(("name", "causes"), [("quad_diodes", 14), ("triad_bumpy_ring", 11), ("quad_light_ring", 14)])
def test_each_design_has_the_causes_of_its_sensors(name: DesignName, causes: int) -> None:
    hypotheses = Posor(design(name)).hypotheses
    assert len(hypotheses.causes) == causes
    assert all(cause.source.startswith(("assumed", "single error")) for cause in hypotheses.causes)
    of_bits = [each for each in hypotheses.names if each.startswith("bit of gap converter")]
    probes = sum(each.startswith("gap ") for each in Posor(design(name)).stack.reading_names)
    assert len(of_bits) == 2**probes - 1 - probes


def test_every_default_is_a_valid_entry_and_every_phrase_has_readings() -> None:
    assert {cause.moves for cause in DEFAULT_CAUSES} <= set(MOVES)
    for moves, move in MOVES.items():
        for unit in move.units:
            entry = Cause(name="x", moves=moves, unit=unit, unlimited=True, source="test")
            stack: DesignName = "quad_bumpy_ring" if "ring" in moves else "quad_diodes"
            names = Posor(calibration_from({**content(), **_sensors(stack), "causes": [entry.model_dump()]}))
            assert any(each.split(":")[0] == "x" for each in names.hypotheses.names), moves


def test_more_causes_than_a_message_holds_are_refused() -> None:
    causes = [{**VALID, "name": f"cause {number}", "moves": "all gap probes"} for number in range(MAX_CAUSES)]
    Posor(calibration_from(content(*causes[:40])))
    error = refusal(CalibrationError, Posor, calibration_from(content(*causes)))
    assert error.expected == f"at most {MAX_CAUSES}"


def _sensors(stack: DesignName) -> dict[str, Any]:
    return design(stack).model_dump(mode="json", exclude_none=True)


def test_one_home_of_the_probability_of_a_false_alarm() -> None:
    assert FALSE_ALARM == 1e-4
    assert PosorParameters.model_fields["false_alarm"].default == FALSE_ALARM
    assert ChainParameters.model_fields["false_alarm"].default == FALSE_ALARM

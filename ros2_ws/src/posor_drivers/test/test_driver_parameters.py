# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver: the chosen source adds its own, and every invalid one is refused with one sentence."""

from __future__ import annotations

import pytest
from posor.errors import ParameterError
from posor.parameter_model import validate_parameters
from posor_drivers.driver_parameters import driver_parameters_for

NODE = "node /joint1/driver_node"
BAG: dict[str, object] = {"source": "bag", "bag.path": "bag"}


def refusal(parameters: dict[str, object]) -> str:
    with pytest.raises(ParameterError) as refused:
        validate_parameters(driver_parameters_for(parameters), parameters, node="/joint1/driver_node")
    return str(refused.value)


NO_PARAMETER = "there is no such parameter; expected perhaps"
OTHER_METHOD = "expected method 'mean' or 'trimmed', or 1 sample"
INVALID: list[tuple[dict[str, object], str]] = [
    ({"bag.pth": "x"}, f", parameter 'bag.pth': {NO_PARAMETER} 'bag.path'."),
    ({"rate": -1.0}, ", parameter 'rate': -1.0 is wrong; expected a number at least 0.0 and at most 10000.0."),
    ({"start_offset": 1.0, "stop_offset": 1.0}, ": 'stop_offset' 1.0 is not greater than 'start_offset' 1.0."),
]
CONDITIONING: list[tuple[dict[str, object], str]] = [
    ({"method": "median"}, ", parameter 'METHOD': 'median' is wrong; expected one of 'none', 'mean', 'trimmed'."),
    ({"samples": 0}, ", parameter 'SAMPLES': 0 is wrong; expected an integer at least 1 and at most 1000."),
    (
        {"significance": 0.0},
        ", parameter 'conditioning.significance': 0.0 is wrong; expected a number greater than 0.0 and at most 0.2.",
    ),
    ({"subtract_dark": "yes"}, ", parameter 'conditioning.subtract_dark': 'yes' is wrong; expected true or false."),
    ({"sample": 5}, f", parameter 'conditioning.sample': {NO_PARAMETER} 'SAMPLES'."),
    ({"method": "mean"}, ": 'SAMPLES' 1 is too few for 'METHOD' 'mean'; expected at least 2."),
    ({"method": "trimmed", "samples": 2}, ": 'SAMPLES' 2 is too few for 'METHOD' 'trimmed'; expected at least 3."),
    ({"samples": 5}, f": 'SAMPLES' is 5 but 'METHOD' is 'none'; {OTHER_METHOD}."),
]


@pytest.mark.parametrize(("parameters", "sentence"), INVALID)
def test_invalid_parameter_is_refused(parameters: dict[str, object], sentence: str) -> None:
    assert refusal(BAG | parameters) == NODE + sentence


@pytest.mark.parametrize(("parameters", "sentence"), CONDITIONING)
def test_invalid_conditioning_is_refused(parameters: dict[str, object], sentence: str) -> None:
    sentence = sentence.replace("SAMPLES", "conditioning.samples").replace("METHOD", "conditioning.method")
    assert refusal(BAG | {f"conditioning.{name}": value for name, value in parameters.items()}) == NODE + sentence


@pytest.mark.parametrize("source", ["looped", "simulated"])
@pytest.mark.parametrize("name", ["rate", "loop", "restamp", "start_offset", "stop_offset"])
def test_parameters_of_a_replay_are_refused_for_live_sources(source: str, name: str) -> None:
    assert refusal({"source": source, name: 1}) == (
        f"parameter '{name}': source '{source}' is live and cannot be replayed; "
        "expected a recorded source, or no parameters of a replay."
    )


def test_unknown_source_is_refused_with_those_that_exist() -> None:
    assert refusal({"source": "tabel"}).startswith(
        "parameter 'source': source 'tabel' is unknown; expected one of 'bag', "
    )

"""Parameters of the driver: the chosen source adds its own, and every invalid one is refused with one sentence."""

from __future__ import annotations

from typing import Any

import pytest
from posor.errors import ParameterError
from posor.parameter_model import validate_parameters
from posor_drivers.driver_parameters import driver_parameters_for

NODE = "node /joint1/driver_node"
BAG = {"source": "bag", "bag.path": "bag"}


def refusal(parameters: dict[str, object]) -> str:
    with pytest.raises(ParameterError) as refused:
        validate_parameters(driver_parameters_for(parameters), parameters, node="/joint1/driver_node")
    return str(refused.value)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        (
            {"source": "table", "table.pth": "x"},
            "'table.pth': there is no such parameter; expected perhaps 'table.path'.",
        ),
        (BAG | {"rate": -1.0}, "'rate': -1.0 is wrong; expected a number at least 0.0 and at most 10000.0."),
    ],
)
def test_invalid_parameter_is_refused(parameters: dict[str, object], sentence: str) -> None:
    assert refusal(parameters) == f"{NODE}, parameter {sentence}"


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"method": "median"}, ".method': 'median' is wrong; expected one of 'none', 'mean', 'trimmed'."),
        ({"method": "mean", "samples": 0}, ".samples': 0 is wrong; expected an integer at least 1 and at most 1000."),
        (
            {"method": "trimmed", "samples": 5, "significance": 0.0},
            ".significance': 0.0 is wrong; expected a number greater than 0.0 and at most 0.2.",
        ),
        ({"subtract_dark": "yes"}, ".subtract_dark': 'yes' is wrong; expected true or false."),
        ({"sample": 5}, ".sample': there is no such parameter; expected perhaps 'conditioning.samples'."),
    ],
)
def test_invalid_conditioning_is_refused(parameters: dict[str, Any], sentence: str) -> None:
    conditioning = {f"conditioning.{name}": value for name, value in parameters.items()}
    assert refusal(BAG | conditioning) == f"{NODE}, parameter 'conditioning{sentence}"


@pytest.mark.parametrize(
    ("method", "samples", "what"),
    [
        ("mean", 1, "1 is too few for 'conditioning.method' 'mean'; expected at least 2"),
        ("trimmed", 2, "2 is too few for 'conditioning.method' 'trimmed'; expected at least 3"),
        ("none", 5, "is 5 but 'conditioning.method' is 'none'; expected method 'mean' or 'trimmed', or 1 sample"),
    ],
)
def test_samples_that_do_not_fit_the_method_are_refused(method: str, samples: int, what: str) -> None:
    parameters = BAG | {"conditioning.method": method, "conditioning.samples": samples}
    assert refusal(parameters) == f"{NODE}: 'conditioning.samples' {what}."


@pytest.mark.parametrize("source", ["looped", "simulated"])
@pytest.mark.parametrize("name", ["rate", "loop", "restamp", "start_offset", "stop_offset"])
def test_parameters_of_a_replay_are_refused_for_live_sources(source: str, name: str) -> None:
    assert refusal({"source": source, name: 1}) == (
        f"parameter '{name}': source '{source}' is live and cannot be replayed; "
        "expected a recorded source, or no parameters of a replay."
    )


def test_offsets_in_the_wrong_order_are_refused() -> None:
    assert refusal(BAG | {"start_offset": 1.0, "stop_offset": 1.0}) == (
        f"{NODE}: 'stop_offset' 1.0 is not greater than 'start_offset' 1.0."
    )


def test_unknown_source_is_refused_with_those_that_exist() -> None:
    assert refusal({"source": "tabel"}).startswith(
        "parameter 'source': source 'tabel' is unknown; expected one of 'bag', "
    )

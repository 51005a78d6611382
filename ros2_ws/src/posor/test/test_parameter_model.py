from __future__ import annotations

import math
from array import array
from typing import Annotated, Any, Literal

import pytest
from posor.errors import ParameterError
from posor.node_parameters import NodeParameters
from posor.parameter_model import (
    ChangeableAtRunTime,
    ParameterGroup,
    help_text,
    parameter_specs,
    parameter_value,
    validate_parameters,
)
from pydantic import Field, ValidationError, model_validator


class BagGroup(ParameterGroup):
    path: Annotated[str, Field(min_length=1)] = Field(description="the bag")
    topics: tuple[str, ...] = Field(default=(), description="topics")


class Example(NodeParameters):
    rate: Annotated[float, Field(ge=0.0, le=10.0), ChangeableAtRunTime()] = Field(default=1.0, description="speed")
    above: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(default=0.5, description="a share")
    limit: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = Field(default=math.inf, description="a limit")
    count: Annotated[int, Field(ge=1)] = Field(default=3, description="how many")
    mode: Literal["exit", "stay"] = Field(default="exit", description="what then")
    gains: tuple[float, ...] = Field(default=(1.0, 2.0), description="gains")
    bag: BagGroup

    @model_validator(mode="after")
    def _limit_above_rate(self) -> Example:
        if self.limit < self.rate:
            raise ValueError(f"'limit' {self.limit} is less than 'rate' {self.rate}")
        return self


def error_of(**values: Any) -> str:
    named = {name.replace("__", "."): value for name, value in values.items()}
    with pytest.raises(ParameterError) as caught:
        validate_parameters(Example, {"bag.path": "x", **named}, node="/joint1/driver")
    return str(caught.value)


def test_values_reach_the_model_and_defaults_fill_the_rest() -> None:
    values = {
        "bag.path": "a.mcap",
        "rate": 2,
        "bag.topics": ["/x", "/y"],
        "gains": array("d", [3.0]),
        "limit": math.inf,
    }
    parameters = validate_parameters(Example, values, node="/n")
    assert parameters.rate == 2.0
    assert isinstance(parameters.rate, float)
    assert parameters.bag == BagGroup(path="a.mcap", topics=("/x", "/y"))
    assert parameters.gains == (3.0,)
    assert parameters.autostart is True
    assert parameter_value(parameters, "bag.path") == "a.mcap"
    with pytest.raises(ValidationError, match="frozen"):
        parameters.rate = 3.0


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"rate": 11.0}, "'rate': 11.0 is wrong; expected a number at least 0.0 and at most 10.0."),
        ({"rate": "2"}, "'rate': '2' is wrong; expected a number at least 0.0 and at most 10.0."),
        ({"rate": True}, "'rate': True is wrong; expected a number at least 0.0 and at most 10.0."),
        ({"rate": math.nan}, "'rate': nan is wrong; expected a number at least 0.0 and at most 10.0."),
        ({"rate": math.inf}, "'rate': inf is wrong; expected a number at least 0.0 and at most 10.0."),
        ({"rate": -math.inf}, "'rate': -inf is wrong; expected a number at least 0.0 and at most 10.0."),
        ({"above": 1.0}, "'above': 1.0 is wrong; expected a number greater than 0.0 and less than 1.0."),
        ({"count": 2.0}, "'count': 2.0 is wrong; expected an integer at least 1."),
        ({"count": 0}, "'count': 0 is wrong; expected an integer at least 1."),
        ({"mode": "quit"}, "'mode': 'quit' is wrong; expected one of 'exit', 'stay'."),
        ({"autostart": "yes"}, "'autostart': 'yes' is wrong; expected true or false."),
        ({"bag__path": ""}, "'bag.path': '' is wrong; expected a string of length 1 or more."),
        ({"bag__topics": ["/x", 2]}, "'bag.topics': 2 is wrong; expected a list of strings."),
        ({"bag__topics": "/x"}, "'bag.topics': '/x' is wrong; expected a list of strings."),
        ({"rat": 1.0}, "'rat': there is no such parameter; expected perhaps 'rate'."),
        ({"bag__pth": "x"}, "'bag.pth': there is no such parameter; expected perhaps 'bag.path'."),
        ({"losless": True}, "'losless': there is no such parameter; expected perhaps 'lossless'."),
    ],
)
def test_an_error_names_node_parameter_value_and_constraint(values: dict[str, object], expected: str) -> None:
    assert error_of(**values) == f"node /joint1/driver, parameter {expected}"


def test_a_missing_value_is_named_with_its_description() -> None:
    with pytest.raises(ParameterError) as caught:
        validate_parameters(Example, {}, node="/n")
    assert (
        str(caught.value)
        == "node /n, parameter 'bag.path': is not set; expected a string of length 1 or more: the bag."
    )


def test_a_relation_between_parameters_is_checked() -> None:
    assert error_of(rate=3.0, limit=2.0) == "node /joint1/driver: 'limit' 2.0 is less than 'rate' 3.0."


def test_specs_have_bounds_choices_and_read_only_marks() -> None:
    by_name = {spec.name: spec for spec in parameter_specs(Example)}
    assert (by_name["rate"].bound("ge", "gt"), by_name["rate"].bound("le", "lt")) == (0.0, 10.0)
    assert (by_name["count"].bound("ge", "gt"), by_name["count"].bound("le", "lt")) == (1, None)
    assert not by_name["rate"].read_only
    assert by_name["count"].read_only
    assert by_name["mode"].choices == ("exit", "stay")
    assert by_name["bag.topics"].is_list
    assert by_name["bag.path"].required
    assert not by_name["bag.topics"].required


def test_the_help_text_follows_from_the_declaration() -> None:
    lines = help_text(Example).splitlines()
    assert "  rate: a number at least 0.0 and at most 10.0 (default: 1.0)" in lines
    assert "      speed [may be set at run time]" in lines
    assert "  mode: one of 'exit', 'stay' (default: 'exit')" in lines
    assert "  bag.path: a string of length 1 or more (default: none, must be given)" in lines
    assert "  bag.topics: a list of strings (default: [])" in lines
    assert "  autostart: true or false (default: true)" in lines
    assert "  limit: a number greater than 0.0 (default: inf)" in lines


def test_a_field_without_a_ros_type_is_a_programming_error() -> None:
    class Odd(ParameterGroup):
        when: dict[str, int] = Field(default={}, description="no ROS type")

    with pytest.raises(TypeError, match="when"):
        _ = next(parameter_specs(Odd)).element_type

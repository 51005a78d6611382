from __future__ import annotations

import math
from array import array
from typing import Annotated, Any, Literal

import pytest
from posor_estimator.errors import ParameterError
from posor_estimator.ros.parameters import (
    ChangeableAtRunTime,
    NodeParameters,
    ParameterGroup,
    help_text,
    specs,
    validate,
    value_of,
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


def sentence_of(**values: Any) -> str:
    named = {name.replace("__", "."): value for name, value in values.items()}
    with pytest.raises(ParameterError) as caught:
        validate(Example, {"bag.path": "x", **named}, node="/joint1/driver")
    return str(caught.value)


def test_values_reach_the_model_and_defaults_fill_the_rest() -> None:
    values = {
        "bag.path": "a.mcap",
        "rate": 2,
        "bag.topics": ["/x", "/y"],
        "gains": array("d", [3.0]),
        "limit": math.inf,
    }
    parameters = validate(Example, values, node="/n")
    assert parameters.rate == 2.0
    assert isinstance(parameters.rate, float)
    assert parameters.bag == BagGroup(path="a.mcap", topics=("/x", "/y"))
    assert parameters.gains == (3.0,)
    assert parameters.autostart is True
    assert value_of(parameters, "bag.path") == "a.mcap"
    with pytest.raises(ValidationError, match="frozen"):
        parameters.rate = 3.0


def test_wrong_value_names_node_parameter_value_and_what_would_be_right() -> None:
    where = "node /joint1/driver, parameter "
    assert sentence_of(rate=11.0) == where + "'rate': 11.0 is wrong; expected a number at least 0.0 and at most 10.0."
    assert sentence_of(rate="2") == where + "'rate': '2' is wrong; expected a number at least 0.0 and at most 10.0."
    assert sentence_of(rate=True) == where + "'rate': True is wrong; expected a number at least 0.0 and at most 10.0."
    assert (
        sentence_of(above=1.0) == where + "'above': 1.0 is wrong; expected a number greater than 0.0 and less than 1.0."
    )
    assert sentence_of(count=2.0) == where + "'count': 2.0 is wrong; expected an integer at least 1."
    assert sentence_of(count=0) == where + "'count': 0 is wrong; expected an integer at least 1."
    assert sentence_of(mode="quit") == where + "'mode': 'quit' is wrong; expected one of 'exit', 'stay'."
    assert sentence_of(autostart="yes") == where + "'autostart': 'yes' is wrong; expected true or false."
    assert sentence_of(bag__path="") == where + "'bag.path': '' is wrong; expected a string of length 1 or more."
    assert sentence_of(bag__topics=["/x", 2]) == where + "'bag.topics': 2 is wrong; expected a list of strings."
    assert sentence_of(bag__topics="/x") == where + "'bag.topics': '/x' is wrong; expected a list of strings."


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_are_finite_unless_declared_otherwise(value: float) -> None:
    assert sentence_of(rate=value).startswith(f"node /joint1/driver, parameter 'rate': {value!r} is wrong")


def test_missing_value_is_named_with_its_meaning() -> None:
    with pytest.raises(ParameterError) as caught:
        validate(Example, {}, node="/n")
    assert (
        str(caught.value)
        == "node /n, parameter 'bag.path': is not set; expected a string of length 1 or more: the bag."
    )


def test_unknown_name_is_refused_with_the_nearest_one() -> None:
    assert (
        sentence_of(rat=1.0)
        == "node /joint1/driver, parameter 'rat': there is no such parameter; expected perhaps 'rate'."
    )
    assert sentence_of(bag__pth="x").endswith("expected perhaps 'bag.path'.")
    assert sentence_of(qos_dept=1).endswith("expected perhaps 'qos_depth'.")


def test_relation_between_parameters_is_checked() -> None:
    assert sentence_of(rate=3.0, limit=2.0) == "node /joint1/driver: 'limit' 2.0 is less than 'rate' 3.0."


def test_specs_tell_range_choices_and_what_may_change() -> None:
    by_name = {spec.name: spec for spec in specs(Example)}
    assert by_name["rate"].bounds == (0.0, 10.0)
    assert by_name["count"].bounds == (1, None)
    assert not by_name["rate"].read_only
    assert by_name["count"].read_only
    assert by_name["mode"].choices == ("exit", "stay")
    assert by_name["bag.topics"].is_list
    assert by_name["bag.path"].required
    assert not by_name["bag.topics"].required


def test_help_comes_from_the_declaration() -> None:
    lines = help_text(Example).splitlines()
    assert "  rate: a number at least 0.0 and at most 10.0 (default: 1.0)" in lines
    assert "      speed [may be set at run time]" in lines
    assert "  mode: one of 'exit', 'stay' (default: 'exit')" in lines
    assert "  bag.path: a string of length 1 or more (default: none, must be given)" in lines
    assert "  bag.topics: a list of strings (default: [])" in lines
    assert "  autostart: true or false (default: true)" in lines
    assert "  limit: a number greater than 0.0 (default: inf)" in lines


def test_field_of_a_type_that_ros_has_not_is_a_programming_error() -> None:
    class Odd(ParameterGroup):
        when: dict[str, int] = Field(default={}, description="no ROS type")

    with pytest.raises(TypeError, match="when"):
        _ = next(specs(Odd)).element_type

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from array import array
from typing import Annotated, Literal

import pytest
from posor.errors import ParameterError
from posor.node_parameters import ChainParameters, NodeParameters, PosorParameters
from posor.parameter_model import (
    ChangeableAtRunTime,
    ParameterGroup,
    help_text,
    parameter_specs,
    parameter_value,
    validate_parameters,
)
from posor_lab.harness.case_tables import cases, refusal
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


def refused(values: dict[str, object], node: str = "/joint1/driver") -> ParameterError:
    return refusal(ParameterError, validate_parameters, Example, values, node=node)


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


@pytest.mark.parametrize(**cases(__file__, "wrong_parameters.yaml"))
def test_an_error_names_node_parameter_value_and_constraint(name: str, value: object, says: str) -> None:
    error = refused({"bag.path": "x", name: value})
    assert str(error) == f"node /joint1/driver, parameter '{name}': {says}"
    assert error.parameter == name


@pytest.mark.parametrize(
    ("name", "value", "converted"),
    [("rate", 2, 2.0), ("count", 4.0, 4), ("gains", [1, 2.5], (1.0, 2.5)), ("gains", None, ()), ("bag.topics", [], ())],
)
def test_values_have_the_type_of_their_parameter_where_no_information_is_lost(
    name: str, value: object, converted: object
) -> None:
    found = parameter_value(validate_parameters(Example, {"bag.path": "x", name: value}, node="/n"), name)
    assert (type(found), found) == (type(converted), converted)


def test_a_missing_value_is_named_with_its_description() -> None:
    sentence = "node /n, parameter 'bag.path': is not set; expected a string of length 1 or more: the bag."
    assert str(refused({}, "/n")) == sentence


def test_a_relation_between_parameters_is_checked() -> None:
    error = refused({"bag.path": "x", "rate": 3.0, "limit": 2.0})
    assert str(error) == "node /joint1/driver: 'limit' 2.0 is less than 'rate' 3.0."


def test_specs_have_bounds_choices_and_read_only_marks() -> None:
    by_name = {spec.name: spec for spec in parameter_specs(Example)}
    assert (by_name["rate"].bound("ge", "gt"), by_name["rate"].bound("le", "lt")) == (0.0, 10.0)
    assert (by_name["count"].bound("ge", "gt"), by_name["count"].bound("le", "lt")) == (1, None)
    assert [by_name[name].when for name in ("rate", "count", "autostart")] == ["at run time", "", "only at the start"]
    assert by_name["autostart"].read_only
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


@pytest.mark.parametrize("name", ["my-encoders", "my encoders", "/1x/enc", "", "a//b", "a/", "/", "~a", "{joint}/b"])
def test_topics_that_ros_refuses_are_refused(name: str) -> None:
    error = refusal(
        ParameterError, validate_parameters, PosorParameters, {"calibration": "x", "encoder.topic": name}, node="/n"
    )
    assert (error.parameter, error.what.partition(";")[0]) == ("encoder.topic", f"'{name}' is wrong")
    if name:
        values = {"urdf": "x", "encoders.topic": name, "encoders.sigma": [1.0]}
        refusal(ParameterError, validate_parameters, ChainParameters, values, node="/n")


@pytest.mark.parametrize("name", ["encoder", "/a/b_2", "~/x", "_a/b", "{namespace}/encoders"])
def test_topics_that_ros_accepts_are_accepted(name: str) -> None:
    values = {"calibration": "x", "encoder.topic": name}
    assert validate_parameters(PosorParameters, values, node="/n").encoder.topic == name

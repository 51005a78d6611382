# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A node as a program: start, refusals, signals, lifecycle services, parameters, diagnostics."""

from __future__ import annotations

import math
import signal
from pathlib import Path
from typing import Annotated

import pytest
import yaml
from lifecycle_msgs.msg import Transition
from posor.errors import ParameterError
from posor.node_parameters import NodeParameters
from posor.parameter_model import parameter_specs
from posor_lab.harness.graph import Graph, values_of
from posor_lab.harness.program import Program, error_lines, script
from posor_ros.declared_parameters import descriptor_of
from posor_ros.node_program import non_ros_arguments, run_node
from posor_ros.ros_arguments import ros_arguments
from pydantic import Field
from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

from .example_node import ExampleNode

pytestmark = pytest.mark.usefixtures("ros_domain")

EXAMPLE = script(Path(__file__).with_name("example_node.py"))
HOOKS_TO_ACTIVE = ["configure", "activate, publisher active: True"]
HOOKS_TO_END = ["deactivate, publisher active: True", "cleanup"]


def start_example(namespace: str = "", **parameters: object) -> Program:
    return Program([*EXAMPLE, *ros_arguments(parameters, namespace)])


def run_to_end(*arguments: str) -> tuple[int, list[str], list[str]]:
    with Program([*EXAMPLE, *arguments]) as program:
        return program.wait(), program.errors, program.stdout


def run_here(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[str], list[str]]:
    """Do the same in the process of the test."""
    capfd.readouterr()
    code = run_node(ExampleNode, [ExampleNode.NAME, *arguments])
    out, err = capfd.readouterr()
    return code, error_lines(err.splitlines()), out.splitlines()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_an_active_node_cleanly(number: signal.Signals) -> None:
    with start_example() as node:
        node.wait_for_line("activate")
        assert node.end(number) == 0
        assert node.stdout == HOOKS_TO_ACTIVE + HOOKS_TO_END
        assert node.errors == []


COUNT_IS_WRONG = "node /example, parameter 'count': 10 is wrong; expected an integer at least 1 and at most 9."
COUNT_IS_FIXED = (
    "node /example, parameter 'count': cannot change while the node is configured; "
    "expected the transition 'cleanup' before."
)
WRONG_FILE = "example:\n  ros__parameters:\n    names: [a, b]\n    count: 10\n"
OTHER_FILE = "exemple:\n  ros__parameters: {count: 3}\n"


@pytest.mark.parametrize(
    ("arguments", "code", "error", "stdout"),
    [
        (["-p", "count:=10"], 2, COUNT_IS_WRONG, []),
        (["--params-file", WRONG_FILE], 2, COUNT_IS_WRONG, []),
        (["--params-file", OTHER_FILE], 2, "has no section for /example, only for '/exemple'; expected '/example'", []),
        (
            ["-r", "__ns:=/joint1", "-p", "gian:=1.0"],
            2,
            "node /joint1/example, parameter 'gian': there is no such parameter; expected perhaps 'gain'.",
            [],
        ),
        (["-p", "names:=[]", "-p", "count:=2.5"], 2, COUNT_IS_WRONG.replace("10", "2.5"), []),
        (["-p", "fail:=configure"], 1, "some.yaml: is wrong; expected a right one.", ["configure"]),
        (["-p", "fail:=activate"], 1, "some.yaml: is wrong.", [*HOOKS_TO_ACTIVE, "cleanup"]),
        (["-p"], 2, "ROS arguments: cannot be understood, ", []),
        (["--params-file", "nowhere.yaml"], 2, "ROS arguments: cannot be understood, ", []),
        (["-x"], 2, "ROS arguments: cannot be understood, ", []),
    ],
)
def test_a_wrong_argument_or_a_refusing_hook_ends_the_program_with_one_sentence(
    arguments: list[str], code: int, error: str, stdout: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    if arguments[-1] in {WRONG_FILE, OTHER_FILE}:
        file = tmp_path / "parameters.yaml"
        file.write_text(arguments[-1], encoding="utf-8")
        arguments = [*arguments[:-1], str(file)]
    found, errors, lines = run_here(capfd, "--ros-args", *arguments)
    assert (found, len(errors), lines) == (code, 1, stdout)
    assert error in errors[0]


def test_the_exit_code_of_the_program_is_that_of_the_refusal() -> None:
    assert run_to_end("--ros-args", "-p", "count:=10") == (2, [COUNT_IS_WRONG], [])


def test_a_boolean_of_rclpy_that_is_text_ends_the_program() -> None:
    code, errors, lines = run_to_end("--ros-args", "-p", "use_sim_time:='true'")
    assert (code, lines) == (2, [])
    assert "parameter 'use_sim_time': 'true'; expected true or false" in errors[-1]


def test_an_exception_in_a_hook_shows_its_traceback() -> None:
    code, stderr, _ = run_to_end("--ros-args", "-p", "fail:=bug")
    assert code == 1
    assert stderr[-1] == "KeyError: 'a bug'"


def test_an_argument_that_is_not_of_ros_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    code, stderr, _ = run_here(capfd, "--calibration", "x.yaml")
    assert (code, stderr) == (2, ["example: argument '--calibration' is unknown; expected --ros-args -p name:=value."])


REMAP = (
    "OLD:=NEW, names separated by '/', each a letter or underscore, then letters, digits and underscores; "
    "a namespace begins with '/'"
)


@pytest.mark.parametrize(
    ("option", "given", "expected"),
    [
        ("-p", "gain=1.0", "NAME:=VALUE, the value in YAML"),
        ("--param", "gain", "NAME:=VALUE, the value in YAML"),
        ("-p", "gain:=[1", "NAME:=VALUE, the value in YAML"),
        ("-r", "__ns=/joint1", REMAP),
        ("-r", "__ns:=/joint-1", REMAP),
        ("--remap", "__ns:=joint1", REMAP),
        ("-r", "raw:=1/raw", REMAP),
    ],
)
def test_an_invalid_ros_argument_is_named(option: str, given: str, expected: str) -> None:
    with pytest.raises(ParameterError) as caught:
        non_ros_arguments(["example", "--ros-args", option, given])
    assert str(caught.value) == f"ROS argument {option}: '{given}' cannot be understood; expected {expected}."


def test_an_invalid_namespace_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    code, stderr, _ = run_here(capfd, "--ros-args", "-r", "__ns:=/joint1/")
    assert code == 2
    assert "namespace" in stderr[-1]
    assert "Traceback" not in "".join(stderr)


def test_help_lists_the_parameters(capfd: pytest.CaptureFixture[str]) -> None:
    code, stderr, stdout = run_here(capfd, "--help")
    assert (code, stderr) == (0, [])
    assert stdout[0] == "example: An example."
    assert "  gain: a number at least 0.0 and at most 5.0 (default: 1.0)" in stdout


def test_lifecycle_services_control_a_node_without_autostart() -> None:
    with start_example(autostart=False) as node, Graph() as graph:
        assert graph.state("/example") == "unconfigured"
        for transition, state in (
            (Transition.TRANSITION_CONFIGURE, "inactive"),
            (Transition.TRANSITION_ACTIVATE, "active"),
            (Transition.TRANSITION_DEACTIVATE, "inactive"),
            (Transition.TRANSITION_CLEANUP, "unconfigured"),
            (Transition.TRANSITION_CONFIGURE, "inactive"),
            (Transition.TRANSITION_ACTIVATE, "active"),
        ):
            assert graph.change_state("/example", transition)
            assert graph.state("/example") == state
        assert graph.change_state("/example", Transition.TRANSITION_ACTIVE_SHUTDOWN)
        assert node.wait() == 0
        assert node.stdout == (HOOKS_TO_ACTIVE + HOOKS_TO_END) * 2


def test_an_impossible_transition_is_refused_without_effect() -> None:
    with start_example() as node, Graph() as graph:
        node.wait_for_line("activate")
        assert not graph.change_state("/example", Transition.TRANSITION_CLEANUP)
        assert not graph.change_state("/example", 99)
        assert graph.state("/example") == "active"
        assert node.end() == 0


def test_a_refused_transition_leaves_the_node_in_its_former_state() -> None:
    with start_example(autostart=False, fail="configure") as node, Graph() as graph:
        graph.watch_diagnostics()
        assert not graph.change_state("/example", Transition.TRANSITION_CONFIGURE)
        assert graph.state("/example") == "unconfigured"
        status = graph.wait_for_status("/example: lifecycle", "some.yaml: is wrong; expected a right one.")
        assert status.level == b"\x02"
        node.wait_for_line("some.yaml: is wrong; expected a right one.")
        assert node.end() == 0


@pytest.mark.parametrize(("fail", "configures"), [("late", False), ("active bug", True)])
def test_a_node_that_fails_is_cleaned_up_and_may_begin_again(fail: str, *, configures: bool) -> None:
    with start_example(autostart=False, fail=fail) as node, Graph() as graph:
        for _ in range(2):
            assert graph.change_state("/example", Transition.TRANSITION_CONFIGURE) == configures
            if configures:
                assert not graph.change_state("/example", Transition.TRANSITION_ACTIVATE)
            assert graph.state("/example") == "unconfigured"
            graph.wait_until(lambda: graph.node.count_publishers("/output") == 0, "the publisher's end")
        assert node.end() == 0
        assert node.stdout.count("cleanup") == 2


def test_a_refused_activation_leaves_no_publisher_active() -> None:
    with start_example(autostart=False, fail="activate") as node, Graph() as graph:
        assert graph.change_state("/example", Transition.TRANSITION_CONFIGURE)
        assert not graph.change_state("/example", Transition.TRANSITION_ACTIVATE)
        assert graph.state("/example") == "inactive"
        assert node.end() == 0
        assert node.stdout == [*HOOKS_TO_ACTIVE, "cleanup"]


def test_descriptors_have_type_description_range_and_read_only_mark() -> None:
    with start_example(), Graph() as graph:
        names = ["gain", "names", "count", "fail", "autostart"]
        gain, names_, count, fail, autostart = graph.call(
            DescribeParameters, "/example/describe_parameters", DescribeParameters.Request(names=names)
        ).descriptors
        expected = ParameterDescriptor(
            name="gain",
            type=ParameterType.PARAMETER_DOUBLE,
            description="a gain",
            additional_constraints="a number at least 0.0 and at most 5.0",
        )
        (span,) = gain.floating_point_range
        assert (span.from_value, span.to_value, span.step) == (0.0, 5.0, 0.0)
        gain.floating_point_range = []
        assert gain == expected
        assert (names_.type, names_.read_only) == (ParameterType.PARAMETER_STRING_ARRAY, False)
        (span,) = count.integer_range
        assert (span.from_value, span.to_value, count.read_only) == (1, 9, False)
        assert autostart.read_only
        assert fail.additional_constraints == "one of 'never', 'configure', 'late', 'activate', 'bug', 'active bug'"


class OneBound(NodeParameters):
    most: Annotated[int, Field(le=9)] = Field(default=2, description="a whole number with an upper bound")
    above: Annotated[float, Field(gt=0.5)] = Field(default=2.0, description="a number with a lower bound")


def test_the_range_of_a_parameter_with_one_bound_ends_with_its_type() -> None:
    found = {spec.name: descriptor_of(spec) for spec in parameter_specs(OneBound)}
    whole, number = found["most"].integer_range[0], found["above"].floating_point_range[0]
    assert (whole.from_value, whole.to_value) == (-(2**63), 9)
    assert (number.from_value, number.to_value) == (0.5, math.inf)


def set_parameter(graph: Graph, parameter: Parameter) -> tuple[bool, str]:
    request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
    (result,) = graph.call(SetParameters, "/example/set_parameters", request).results
    return result.successful, result.reason


def parameter_values(graph: Graph) -> dict[str, object]:
    listed = graph.call(ListParameters, "/example/list_parameters", ListParameters.Request()).result.names
    request = GetParameters.Request(names=listed)
    values = graph.call(GetParameters, "/example/get_parameters", request).values
    return {name: parameter_value_to_python(value) for name, value in zip(listed, values, strict=True)}


def test_parameters_of_an_unconfigured_node_may_be_set_and_hold_after_the_next_configuration() -> None:
    with start_example(autostart=False) as node, Graph() as graph:
        for value in (3, 4.0):
            assert set_parameter(graph, Parameter("count", value=value)) == (True, "")
            assert graph.change_state("/example", Transition.TRANSITION_CONFIGURE)
            assert parameter_values(graph)["count"] == value
            assert set_parameter(graph, Parameter("count", value=5)) == (False, COUNT_IS_FIXED)
            assert graph.change_state("/example", Transition.TRANSITION_CLEANUP)
        assert not set_parameter(graph, Parameter("autostart", value=True))[0]
        assert not set_parameter(graph, Parameter("count", value=4.5))[0]
        for names in (["a"], []):
            parameter = Parameter("names", value=names) if names else Parameter("names", Parameter.Type.BOOL_ARRAY, [])
            assert set_parameter(graph, parameter) == (True, "")
            assert parameter_values(graph)["names"] == names
        assert node.end() == 0


def test_a_node_starts_from_a_dump_of_its_parameters(tmp_path: Path) -> None:
    file = tmp_path / "dump.yaml"
    with start_example(gain=2, names=["a"]) as node, Graph() as graph:
        node.wait_for_line("activate")
        dumped = parameter_values(graph)
        assert node.end() == 0
    file.write_text(yaml.safe_dump({"/example": {"ros__parameters": dumped}}), encoding="utf-8")
    with Program([*EXAMPLE, "--ros-args", "--params-file", str(file)]) as node, Graph() as graph:
        node.wait_for_line("activate")
        assert parameter_values(graph) == dumped
        assert node.end() == 0


def test_parameter_changes_at_run_time() -> None:
    with start_example(gain=2) as node, Graph() as graph:

        def set_value(name: str, value: object) -> tuple[bool, str]:
            return set_parameter(graph, Parameter(name, value=value))

        assert parameter_values(graph)["gain"] == 2.0
        assert set_value("gain", 3.0) == (True, "")
        assert set_value("gain", 1) == (True, "")
        assert parameter_values(graph)["gain"] == 1.0
        for name, value in (("gain", 6.0), ("gain", float("nan")), ("gain", "high"), ("count", 3), ("gian", 1.0)):
            successful, reason = set_value(name, value)
            assert not successful
            assert reason
        assert parameter_values(graph)["gain"] == 1.0
        assert node.end() == 0


def test_diagnostics_are_published_at_each_change_and_once_a_second() -> None:
    with Graph() as graph, start_example("/joint1", autostart=False):
        graph.watch_diagnostics()
        graph.wait_for_status("/joint1/example: lifecycle", "unconfigured")
        assert graph.change_state("/joint1/example", Transition.TRANSITION_CONFIGURE)
        assert graph.change_state("/joint1/example", Transition.TRANSITION_ACTIVATE)
        graph.wait_for_status("/joint1/example: work", "third")
        work = [status for status in graph.diagnostics if status.name == "/joint1/example: work"]
        changes = [status.message for status in work if status.message != "no report yet"]
        assert list(dict.fromkeys(changes)) == ["first", "second", "third"]
        assert {status.hardware_id for status in work} == {"joint1"}
        first = next(status for status in work if status.message == "first")
        assert first.level == b"\x01"
        assert [values_of(first)[key] for key in ("number", "flag", "real")] == ["1", "true", "0.1"]
        assert values_of(work[-1])["number"] == "2"
        lifecycle = graph.latest("/joint1/example: lifecycle")
        assert lifecycle is not None
        assert lifecycle.message == "active"
        before = int(values_of(work[-1]).get("refreshed", "0"))
        graph.wait_until(
            lambda: int(values_of(graph.latest("/joint1/example: work")).get("refreshed", "0")) >= before + 2,
            "periodic diagnostics",
        )

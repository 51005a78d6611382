# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sections of ROS parameter files: the same as rclpy finds for a node, and a refusal where there is none."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from posor.errors import ParameterError
from posor_lab.harness.case_tables import refusal
from posor_ros.parameter_files import check_sections, load_parameter_file, parameter_files_of, refuse_octal_arguments
from posor_ros.ros_arguments import split_ros_arguments
from rclpy.context import Context
from rclpy.node import Node

NODE = "/arm/joint1/some_node"


def text_of(name: str) -> str:
    """Return a file with a section of a name; spaces nest it."""
    lines = [f"{' ' * n}{part}:\n" for n, part in enumerate(name.split())]
    return "".join([*lines, f"{' ' * len(lines)}ros__parameters: {{number: 1, group: {{text: a}}}}\n"])


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(
    "name",
    [
        *("/arm/joint1/some_node", "arm/joint1/some_node", "arm joint1 some_node", "/arm/joint1 some_node", "/**"),
        *("/**/some_node", "/arm/**", "/arm/*/some_node", "/*/some_node", "/*", "/arm/joint1/**"),
        *("some_node", "/some_node", "/arm/some_node", "/arm/joint1/some_nod", "/arm/joint1/some_node2", "/arm/*"),
    ],
)
def test_a_section_is_for_the_nodes_to_which_rclpy_gives_it(name: str, tmp_path: Path) -> None:
    file, context = tmp_path / "file.yaml", Context()
    file.write_text(text_of(name), encoding="utf-8")
    (section,) = load_parameter_file(file)
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context)
    node = Node(
        "some_node", context=context, namespace="/arm/joint1", automatically_declare_parameters_from_overrides=True
    )
    try:
        assert section.is_for(NODE) == node.has_parameter("group.text") == node.has_parameter("number")
        assert section.parameters == {"number": 1, "group.text": "a"}
    finally:
        node.destroy_node()
        context.shutdown()


def make_log() -> Any:
    """Return a logger that keeps what is logged."""
    warnings, informations = list[str](), list[str]()
    return SimpleNamespace(
        warnings=warnings, informations=informations, warning=warnings.append, info=informations.append
    )


def test_a_file_without_a_section_for_the_node_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text(text_of("some_node") + text_of("/other"), encoding="utf-8")
    assert str(refusal(ParameterError, check_sections, [file], [NODE], make_log())) == (
        f"parameter file {file}: has no section for {NODE}, only for '/some_node', '/other'; "
        f"expected '{NODE}' or '/**'."
    )


def test_sections_that_no_node_of_the_program_reads_are_logged_and_misspelt_names_are_warnings(tmp_path: Path) -> None:
    file, log = tmp_path / "file.yaml", make_log()
    own, others = ["/arm/*/some_node", "/**"], ["/arm/jiont2/some_node", "/arm/chain_node"]
    file.write_text("".join(map(text_of, [*own, "some_nod", "/**/somenode", *others])), encoding="utf-8")
    check_sections([file], [NODE, "/other"], log)
    assert log.warnings == [
        f"{file}, line {line}, key {key}: no node of this program is called '{name}', perhaps 'some_node'"
        for line, key, name in [(5, "some_nod", "/some_nod"), (7, "/**/somenode", "/**/somenode")]
    ]
    names = "'/some_nod', '/**/somenode', '/arm/jiont2/some_node', '/arm/chain_node'"
    assert log.informations == [f"parameter file {file}: sections that no node of this program reads: {names}"]
    file.write_text("".join(map(text_of, own)), encoding="utf-8")
    check_sections([file], [NODE], quiet := make_log())
    assert quiet.warnings == quiet.informations == []


def test_a_parameter_that_is_stated_as_a_word_and_in_a_group_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text("/**:\n  ros__parameters:\n    age.most: 2.0\n    age: {least: 1.0,\n      most: 3.0}\n")
    error = refusal(ParameterError, load_parameter_file, file)
    assert (error.what, "line 5" in error.where, "line 3" in error.expected) == ("is stated twice", True, True)


@pytest.mark.parametrize(("text", "number"), [("0100", "0100"), ("-010", "-010"), ("[1, 07]", "07"), ("{b: 00}", "00")])
def test_a_number_that_is_octal_to_ros_is_refused(text: str, number: str, tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    a: {text}\n", encoding="utf-8")
    error = refusal(ParameterError, load_parameter_file, file)
    assert (error.what, "line 3" in error.where) == (f"{number} is an octal number to ROS", True)
    file.write_text("/**: {ros__parameters: {a: '0100', b: [0, 0.5, 1], c: 0x10}}\n", encoding="utf-8")
    (section,) = load_parameter_file(file)
    assert section.parameters == {"a": "0100", "b": [0, 0.5, 1], "c": 16}


@pytest.mark.parametrize("value", ["0100", "[1, 0100]"])
def test_an_argument_that_is_octal_to_ros_is_refused(value: str) -> None:
    refuse_octal_arguments(["node", "--ros-args", "-p", "a:=100", "-p", "b:=['0100', 0]", "-r", "c:=010"])
    error = refusal(ParameterError, refuse_octal_arguments, ["node", "--ros-args", "-p", f"a:={value}"])
    assert (error.what, error.where) == ("0100 is an octal number to ROS", f"ROS argument -p a:={value}")


@pytest.mark.parametrize("second", ["{ros_parameters: {number: 1}}", "{number: 1}", "1", "[ros__parameters]", ""])
def test_a_section_without_parameters_is_refused_also_beside_another(second: str, tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text(f"/**: {{ros__parameters: {{}}}}\nsome_node: {second}\n", encoding="utf-8")
    error = refusal(ParameterError, load_parameter_file, file)
    assert (error.what, "line 2, key some_node" in error.where) == ("is not below ros__parameters", True)


def test_ros_arguments_are_split_from_others() -> None:
    arguments = [
        "arm",
        "-p",
        "loop:=true",
        "--ros-args",
        "--params-file",
        "a",
        "-r",
        "b:=c",
        "--",
        "--layout",
        "composed",
    ]
    own, of_ros = split_ros_arguments(arguments)
    assert own == ["arm", "-p", "loop:=true", "--layout", "composed"]
    assert of_ros == ["--params-file", "a", "-r", "b:=c"]
    assert parameter_files_of(of_ros) == [Path("a")]

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor design: every calculator runs from the example of its help; files, units and refusals."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import posor_design
import pytest
import yaml
from posor.errors import ParameterError
from posor_design.calculator_signature import CalculatorSignature, read_signature
from posor_design.calculators import CALCULATORS, annotations_of, unit_of
from posor_design.design_command import PROGRAMS, build_parser, list_calculators, main
from posor_design.quantity_text import parse_unit
from posor_design.value_kinds import name_kind, summarise_value

NAMES = sorted(CALCULATORS)


@cache
def signature_of(name: str) -> CalculatorSignature:
    return read_signature(name)


def example_of(name: str) -> list[str]:
    posor, design, *arguments = shlex.split(signature_of(name).example)
    assert (posor, design, arguments[0]) == ("posor", "design", name)
    return arguments


def arguments_of(name: str, *changes: str) -> dict[str, Any]:
    """Return the arguments of the example of a calculator, with changed ones as options of the command line."""
    signature = signature_of(name)
    options = vars(build_parser(signature).parse_args([*example_of(name)[1:], *changes]))
    return {each.name: options[each.name] for each in signature.arguments}


def test_the_list_has_every_calculator(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    summaries = {name: signature_of(name).summary for name in NAMES}
    summaries |= PROGRAMS
    for name, summary in summaries.items():
        assert [line.split(maxsplit=1)[1] for line in lines if line.startswith(f"  {name} ")] == [summary]
    assert main(["--help"]) == 0
    assert capsys.readouterr().out == list_calculators()


@pytest.mark.parametrize("name", NAMES)
def test_every_calculator_runs_from_its_example(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures, page = tmp_path / "result.json", tmp_path / "result.html"
    assert main([*example_of(name), "--json", str(figures), "--html", str(page)]) == 0
    printed = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    signature, content = signature_of(name), json.loads(figures.read_text(encoding="utf-8"))
    assert content["calculator"] == name
    assert list(content["arguments"]) == [each.name for each in signature.arguments]
    result = signature.function(**{key: tuples(each["value"]) for key, each in content["arguments"].items()})
    for each in signature.results:
        value = getattr(result, each.name)
        assert tuples(content["result"][each.name]["value"]) == value
        assert content["result"][each.name]["unit"] == unit_of(each.kind)
        assert printed[each.name] == summarise_value(each.kind, value)
        assert f"<td>{each.name}</td>" in page.read_text(encoding="utf-8")


def tuples(value: Any) -> Any:
    return tuple(map(tuples, value)) if isinstance(value, list) else value


@pytest.mark.parametrize("name", NAMES)
def test_the_help_of_every_calculator_is_complete(name: str) -> None:
    signature = signature_of(name)
    text = build_parser(signature).format_help()
    for each in (*signature.arguments, *signature.results):
        assert each.description.endswith("."), each.name
        assert parse_unit(unit_of(each.kind)).factor == 1
    for required in (signature.summary, signature.source, signature.example):
        assert required
        assert required in text
    for argument in signature.arguments:
        assert f"{argument.option} VALUE" in text
        assert f"[{name_kind(argument.kind)}]" in " ".join(text.split())


def test_the_package_exports_every_calculator_with_a_frozen_result() -> None:
    exported = {name: value for name, value in vars(posor_design).items() if value in CALCULATORS.values()}
    assert {name.replace("_", "-") for name in exported} == set(CALCULATORS)
    for function in CALCULATORS.values():
        result = annotations_of(function)["return"]
        assert dataclasses.is_dataclass(result)
        assert vars(result)["__dataclass_params__"].frozen, result


def test_calculators_need_no_ros() -> None:
    code = "import sys\nimport posor_design\nassert not {'rclpy', 'ament_index_python'} & set(sys.modules)\n"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["abe-error"], "design: there is no calculator 'abe-error'; expected perhaps 'abbe-error'.\n"),
        (["xyz"], "design: there is no calculator 'xyz'; expected a name that 'posor design' lists.\n"),
        (
            ["abbe-error"],
            "design abbe-error: the following arguments are required: --offset, --angle; expected options",
        ),
        ([*example_of("abbe-error"), "--surprise", "1"], "design abbe-error: unrecognized arguments: --surprise 1;"),
        (
            ["abbe-error", "--offset", "2 in", "--angle", "1 parsec"],
            "design abbe-error, --angle: there is no unit 'parsec' in '1 parsec'; expected a number in rad (deg,",
        ),
        (["abbe-error", "--offset", "2 in", "--angle", "90 deg"], "angle: 1.5708 rad; expected at most 0.2 rad.\n"),
        (
            ["abbe-error", "--offset", "-2in", "--angle", "1"],
            "design abbe-error: --offset has no value; expected a value; a negative one such as --offset=-2in.\n",
        ),
    ],
)
def test_a_wrong_command_line_is_one_sentence(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(message)
    assert captured.err.count("\n") == 1
    assert not captured.out


def test_one_file_for_two_outputs_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x"
    assert main([*example_of("abbe-error"), "--json", str(path), "--html", str(path)]) == 1
    assert f"{path}: is stated twice; expected" in capsys.readouterr().err
    assert not path.exists()


@pytest.mark.parametrize("option", ["--json", "--html"])
def test_a_file_that_cannot_be_written_is_one_sentence_and_no_folder_is_created(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    folder = tmp_path / "new"
    for path, reason in ((tmp_path / "file" / "x", "cannot be written, "), (folder / "x", f"the folder {folder} does")):
        assert main([*example_of("abbe-error"), option, str(path)]) == 1
        assert capsys.readouterr().err.startswith(f"{path}: {reason}")
    assert not folder.exists()


def test_arguments_without_a_solution_are_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*example_of("beam-frequencies"), "--length", "1e6m"]) == 2
    captured = capsys.readouterr()
    sentence = "no solution for these arguments; expected quantities of a usual size; check the units"
    assert captured.err == f"design beam-frequencies: {sentence}.\n"
    assert not captured.out


REFUSALS = yaml.safe_load(Path(__file__).with_name("calculator_refusals.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("name", "change"), [(name, each) for name, changes in REFUSALS.items() for each in changes.split()]
)
def test_an_argument_out_of_its_limits_is_refused(name: str, change: str) -> None:
    option, _, place = change.partition("@")
    argument, _, value = option.partition("=")
    arguments = arguments_of(name, f"--{argument.replace('_', '-')}={value}")
    with pytest.raises(ParameterError) as caught:
        signature_of(name).function(**arguments)
    assert caught.value.where.replace(" ", "_") == (place or argument)


@pytest.mark.parametrize("name", NAMES)
def test_every_number_has_to_be_finite(name: str) -> None:
    arguments = arguments_of(name)
    for argument, value in arguments.items():
        for wrong in (math.nan, math.inf) if isinstance(value, float | tuple) else ():
            changed = (wrong, *value[1:]) if isinstance(value, tuple) else wrong
            with pytest.raises(ParameterError, match="expected a finite number") as caught:
                signature_of(name).function(**{**arguments, argument: changed})
            assert caught.value.where == argument


@pytest.mark.parametrize("extreme", [1e-300, 1e-30, 1e30, 1e300])
@pytest.mark.parametrize("name", NAMES)
def test_a_result_is_finite_or_refused(name: str, extreme: float) -> None:
    signature = signature_of(name)
    arguments = arguments_of(name)
    for argument in [key for key, value in arguments.items() if isinstance(value, float)]:
        try:
            result = signature.function(**{**arguments, argument: extreme})
        except ParameterError:
            continue
        numbers = [number for number in vars(result).values() if not isinstance(number, str)]
        assert all(np.all(np.isfinite(number)) for number in numbers), argument


def test_units_do_not_change_the_result(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["abbe-error", "--offset", "2 in", "--angle", "5 arcsec"]) == 0
    inches = capsys.readouterr().out
    assert main(["abbe-error", "--offset", "50.8 mm", "--angle", f"{5 / 3600} deg"]) == 0
    assert capsys.readouterr().out == inches == "error  1.2314 um\n"


def test_the_page_shows_the_effect_of_each_argument(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert main([*example_of("thermal-growth"), "--html", str(page)]) == 0
    rows = re.findall(
        r'<tr><td>(\w+)</td><td class="number">([-+.\d]+%)</td><td></td></tr>', page.read_text(encoding="utf-8")
    )
    assert rows == [("length", "+1.00%"), ("expansion", "+1.00%"), ("temperature_change", "+1.00%")]
    assert main([*example_of("cantilever-beam"), "--html", str(page)]) == 0
    assert re.search(r"<td>tip_force</td>(<td[^>]*>[^<]*</td>)*<td>from 0</td>", page.read_text(encoding="utf-8"))
    assert main(["abbe-error", "--offset", "2 in", "--angle", ".199 rad", "--html", str(page)]) == 0
    assert "refused: angle: 0.20099 rad" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_get_their_arguments_and_return_their_exit_code(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--surprise"]) == 2
    assert capsys.readouterr().err.startswith(f"design {name}: ")


def test_a_series_is_summarised_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    assert main([*example_of("beam-frequencies"), "--html", str(page)]) == 0
    assert "\npositions            61 values from 0 m to 762 mm\nshapes               4 x 61 values from -1 to 1\n" in (
        capsys.readouterr().out
    )
    text = unquote(page.read_text(encoding="utf-8"))
    assert text.count("<figure>") == 1
    assert "data:text/csv;charset=utf-8,series,positions [m],shapes [1]\nshapes 1,0,1\n" in text

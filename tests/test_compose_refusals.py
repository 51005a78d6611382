# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Refusals of compose: one sentence with the node, and with file, line and key of the cause."""

from __future__ import annotations

from pathlib import Path

import pytest
from posor.errors import CalibrationError
from posor_estimator.compose_command import main
from posor_estimator.composition_file import load_composition
from posor_lab.harness.case_tables import cases, edited, refusal
from posor_lab.harness.program import Program, error_lines
from posor_lab.harness.rig_files import calibration_path, urdf_path

from tests.composed_rig import COMPOSE, NODES, RIG, write_composition

pytestmark = pytest.mark.usefixtures("ros_domain")

CHAIN, POSOR, DRIVER = (f"node {name}" for name in NODES)
CALIBRATION = str(calibration_path("printed"))


def refused(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Run a refused composition in this process; return exit code and error line."""
    code = main(["compose", *arguments])
    (sentence,) = error_lines(capfd.readouterr().err.splitlines())
    return code, sentence


@pytest.mark.long
@pytest.mark.parametrize(
    ("old", "new", "code", "sentence"),
    [
        ("session: ymo}", "session: nmo}", 1, f"{{path}}, line 7, key nodes[1], {POSOR}: calibration "),
        (
            *("loop: true", "stop_offset: 60.0, start_offset: 50.0, wait_for_subscribers: 1", 2),
            f"{DRIVER}: no scan lies between 'start_offset' 50.0",
        ),
    ],
    ids=["at the start", "later"],
)
def test_a_node_that_fails_is_named_and_ends_all_nodes(
    tmp_path: Path, old: str, new: str, code: int, sentence: str
) -> None:
    path = write_composition(tmp_path, edited(RIG, old, new))
    with Program([*COMPOSE, str(path)]) as program:
        assert program.wait() == code
        (said,) = program.errors
        assert said.startswith(sentence.format(path=path))


@pytest.mark.parametrize(**cases(__file__, "composition_parameters.yaml"))
def test_an_invalid_parameter_is_refused_with_its_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, where: str, node: str, parameter: str
) -> None:
    path = write_composition(tmp_path, edited(RIG, old, new))
    code, sentence = refused(capfd, str(path))
    assert code == 2
    assert sentence.startswith(f"{path}, {where}: node {node}, parameter '{parameter}': ")


@pytest.mark.parametrize(
    ("old", "new", "code", "said"),
    [
        (f"calibration: {CALIBRATION}, ", "", 2, f"line 7, key nodes[1]: {POSOR}, parameter 'calibration': "),
        (CALIBRATION, "none.yaml", 1, f"line 7, key nodes[1], {POSOR}: calibration file none.yaml: "),
        (str(urdf_path()), "none.urdf", 1, f"line 4, key nodes[0], {CHAIN}: "),
        (
            *("restamp: true", "realtime: {priority: 5}", 2),
            (
                f"line 10, key nodes[2]: {DRIVER}: parameters 'realtime.*' are of the whole process; "
                "expected them under the key 'realtime' of the composition file."
            ),
        ),
    ],
    ids=["missing parameter", "missing calibration", "missing URDF", "parameter of the process"],
)
def test_what_is_wrong_with_a_node_is_refused_with_its_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, code: int, said: str
) -> None:
    text = edited(RIG, old, new)
    path = write_composition(tmp_path, text.partition("  - node: posor_node")[0] if "urdf" in new else text)
    found, sentence = refused(capfd, str(path))
    assert found == code
    assert sentence.startswith(f"{path}, {said}")


def test_a_parameter_of_the_command_line_is_refused_with_the_line_of_its_node(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_composition(tmp_path, RIG)
    assert main(["compose", str(path), "--ros-args", "-p", "gian:=1"]) == 2
    sentence = error_lines(capfd.readouterr().err.splitlines())[0]
    assert sentence.startswith(f"{path}, line 4, key nodes[0]: {CHAIN}, parameter 'gian': ")


@pytest.mark.parametrize(**cases(__file__, "composition_mistakes.yaml"))
def test_an_invalid_file_is_refused_with_line_and_key(
    tmp_path: Path, old: str, new: str, where: str, says: str
) -> None:
    path = write_composition(tmp_path, edited(RIG, old, new))
    error = refusal(CalibrationError, load_composition, path)
    assert str(error).startswith(f"{path}, {where}: {says}")


def test_an_invalid_command_line_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    missing = tmp_path / "no.yaml"
    sentence = "cannot be read: No such file or directory; expected a YAML composition file."
    assert refused(capfd, str(missing)) == (1, f"composition file {missing}: {sentence}")
    assert main(["compose"]) == 2
    assert capfd.readouterr().err == "compose: 0 arguments; expected one, a composition file.\n"
    assert main(["compose", "--help"]) == 0
    assert "one of chain_node, correction_node, driver_node, posor_node" in capfd.readouterr().out

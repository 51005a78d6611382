"""Refusals of compose: one sentence with the node, and with file, line and key of the cause."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from posor.errors import CalibrationError
from posor_bringup.installed import calibration_path, urdf_path
from posor_estimator.compose_command import main
from posor_estimator.composition_file import load_composition
from posor_lab.harness.program import Program, error_lines

from tests.composed_rig import COMPOSE, NODES, RIG, write_composition

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.fixture
def refusal(capfd: pytest.CaptureFixture[str]) -> Callable[[Path], tuple[int, list[str]]]:
    """Return a function that runs a refused composition in this process; it returns exit code and error lines."""

    def run_refused(path: Path) -> tuple[int, list[str]]:
        code = main(["compose", str(path)])
        return code, error_lines(capfd.readouterr().err.splitlines())

    return run_refused


@pytest.mark.long
def test_a_node_that_cannot_start_is_named_and_ends_all_nodes(
    tmp_path: Path, refusal: Callable[[Path], tuple[int, list[str]]]
) -> None:
    path = write_composition(tmp_path, RIG.replace("session: ymo}", "session: nmo}"))
    with Program([*COMPOSE, str(path)]) as program:
        assert program.wait() == 1
        (sentence,) = program.errors
        assert sentence.startswith(f"{path}, line 7, key nodes[1], node /rig/joint1/posor_node: ")
        assert "'nmo'" in sentence
    code, (sentence,) = refusal(write_composition(tmp_path, RIG.replace("restamp: true", "realtime: {priority: 5}")))
    assert code == 2
    assert sentence == (
        f"{path}, line 10, key nodes[2]: node /rig/joint1/driver_node: parameters 'realtime.*' are of the whole "
        "process; expected them under the key 'realtime' of the composition file."
    )


@pytest.mark.parametrize(
    ("old", "new", "line", "node", "parameter", "fault"),
    [
        ("loop: true", "loop: maybe", 12, 2, "loop", "'maybe' is wrong; expected true or false."),
        (
            ", session: ymo}",
            ",\n      calibraton: x}",
            *(10, 1, "calibraton", "there is no such parameter; expected perhaps 'calibration'."),
        ),
        (
            ", session: ymo}",
            ",\n      limits: {jitter: 1.0,\n       latency: fast}}",
            *(11, 1, "limits.latency", "'fast' is wrong; expected a number greater than 0.0."),
        ),
        (
            ", session: ymo}",
            ",\n      limits.latency: fast}",
            *(10, 1, "limits.latency", "'fast' is wrong; expected a number greater than 0.0."),
        ),
    ],
)
def test_an_invalid_parameter_is_refused_with_its_line(
    tmp_path: Path,
    refusal: Callable[[Path], tuple[int, list[str]]],
    old: str,
    new: str,
    line: int,
    node: int,
    parameter: str,
    fault: str,
) -> None:
    path = write_composition(tmp_path, RIG.replace(old, new))
    place = f"{path}, line {line}, key nodes[{node}].parameters.{parameter}"
    assert refusal(path) == (2, [f"{place}: node {NODES[node]}, parameter '{parameter}': {fault}"])


def test_a_missing_parameter_is_refused_with_the_line_of_its_node(
    tmp_path: Path, refusal: Callable[[Path], tuple[int, list[str]]]
) -> None:
    path = write_composition(tmp_path, RIG.replace(f"calibration: {calibration_path('printed')}, ", ""))
    code, (sentence,) = refusal(path)
    assert code == 2
    assert sentence.startswith(
        f"{path}, line 7, key nodes[1]: node {NODES[1]}, parameter 'calibration': is not set; expected"
    )


def test_a_missing_file_is_refused_with_the_line_of_its_node(
    tmp_path: Path, refusal: Callable[[Path], tuple[int, list[str]]]
) -> None:
    path = write_composition(tmp_path, RIG.replace(str(calibration_path("printed")), "none.yaml"))
    code, (sentence,) = refusal(path)
    assert code == 1
    assert sentence.startswith(
        f"{path}, line 7, key nodes[1], node {NODES[1]}: calibration file none.yaml: cannot be read"
    )
    alone = "\n".join(RIG.splitlines()[:6]).replace(str(urdf_path()), "none.urdf")
    path = write_composition(tmp_path, alone)
    code, (sentence,) = refusal(path)
    assert code == 1
    assert sentence.startswith(f"{path}, line 4, key nodes[0], node /rig/chain_node: ")


def test_a_parameter_of_the_command_line_is_refused_with_the_line_of_its_node(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_composition(tmp_path, RIG)
    assert main(["compose", str(path), "--ros-args", "-p", "gian:=1"]) == 2
    assert error_lines(capfd.readouterr().err.splitlines())[0].startswith(
        f"{path}, line 4, key nodes[0]: node /rig/chain_node, parameter 'gian': there is no such parameter; expected"
    )


@pytest.mark.long
def test_a_node_that_fails_later_ends_all_nodes(tmp_path: Path) -> None:
    text = RIG.replace("loop: true", "stop_offset: 60.0, start_offset: 50.0, wait_for_subscribers: 1")
    with Program([*COMPOSE, str(write_composition(tmp_path, text))]) as program:
        assert program.wait() == 2
        (sentence,) = program.errors
        assert sentence.startswith("node /rig/joint1/driver_node: no scan lies between 'start_offset' 50.0")


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "version: 1",
            "version: 2",
            "line 2, key version: version 2; expected 1, or a later release of this software, which reads version 2.",
        ),
        ("node: chain_node", "node: chian_node", "line 4, key nodes[0].node: node 'chian_node' is unknown; expected"),
        ("namespace: /rig\n", "namespace: rig\n", "line 5, key nodes[0].namespace: namespace 'rig'; expected names"),
        ("{urdf:", "{3: 4, urdf:", "line 6, key nodes[0].parameters.3: name 3; expected text."),
        ("loop: true", "loop: 2020-01-01", "line 12, key nodes[2].parameters.loop: 2020-01-01; expected a truth value"),
        (
            "  - node: posor_node",
            "  - nod: posor_node",
            "line 7, key nodes[1].nod: unknown key 'nod'; expected perhaps 'node'",
        ),
        (
            "node: posor_node",
            "node: driver_node",
            "line 10, key nodes[2]: a second node /rig/joint1/driver_node; expected another name or another namespace.",
        ),
        (
            "version: 1",
            "version: 1\nrealtime: {cpus: [0, -1]}",
            "line 3, key realtime.cpus: [0, -1] is wrong; expected numbers of processors, at least 0.",
        ),
        (
            "version: 1",
            "version: 1\nrealtime: {priorty: 0}",
            "line 3, key realtime.priorty: unknown key 'priorty'; expected perhaps 'priority'.",
        ),
        ("version: 1", "version: 1\nrealtime: 5", "line 3, key realtime: 5; expected a mapping."),
        (
            "version: 1",
            "version: 1\nrealtime: {priority: 100}",
            "line 3, key realtime.priority: 100; expected at most 99.",
        ),
    ],
)
def test_an_invalid_file_is_refused_with_line_and_key(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    path = write_composition(tmp_path, RIG.replace(old, new, 1))
    with pytest.raises(CalibrationError) as caught:
        load_composition(path)
    assert str(caught.value).startswith(f"{path}, {sentence}")


def test_an_invalid_command_line_is_refused(
    tmp_path: Path, refusal: Callable[[Path], tuple[int, list[str]]], capfd: pytest.CaptureFixture[str]
) -> None:
    missing = tmp_path / "no.yaml"
    assert refusal(missing) == (
        1,
        [f"composition file {missing}: cannot be read: No such file or directory; expected a YAML composition file."],
    )
    assert main(["compose"]) == 2
    assert capfd.readouterr().err == "compose: 0 arguments; expected one, a composition file.\n"
    assert main(["compose", "--help"]) == 0
    assert "one of chain_node, driver_node, posor_node" in capfd.readouterr().out

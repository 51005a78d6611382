"""The demo of the simulated arm in trouble: killed nodes, interruptions, wrong options."""

from __future__ import annotations

import os
import re
import shutil
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml
from posor_bringup.arm import main
from posor_bringup.arms import find_arm

from tests.arms import arm, exit_code, nodes_of, nothing_left_of

if TYPE_CHECKING:
    from collections.abc import Iterator

RUNNING = "without controller"
"""What the demo says when its ticks begin."""
pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def output(tmp_path: Path) -> Iterator[Path]:
    """Return where the demo writes."""
    with nothing_left_of(tmp_path / "arm") as folder:
        yield folder


def test_a_killed_node_ends_the_demo_with_a_sentence(output: Path) -> None:
    with arm(output, "--arm", "test_rig", "--arms", "0", "--seconds", "60") as program:
        program.wait_for_line(RUNNING)
        victim = next(
            number
            for number in nodes_of(output)
            if "joint1.posor_node.log" in str(Path(f"/proc/{number}/fd/1").readlink())
        )
        os.kill(victim, signal.SIGKILL)
        assert exit_code(program) == 1
        (sentence,) = program.stderr
        assert sentence.startswith("joint1/posor_node: was ended by SIGKILL; until then: ")


@pytest.mark.parametrize("moment", ["starting 3 nodes", RUNNING])
def test_an_interrupted_demo_leaves_nothing_behind(output: Path, moment: str) -> None:
    with arm(output, "--arm", "test_rig", "--arms", "0", "--seconds", "60") as program:
        program.wait_for_line(moment)
        assert program.end() == 130
        assert program.stderr == ["arm: interrupted."]


def test_drawing_arms_can_be_interrupted(output: Path) -> None:
    with arm(output, "--arm", "test_rig", "--coverage-only", "--arms", "100000") as program:
        program.wait_for_line("drawing 100000 arms")
        assert program.end() == 130
        assert program.stderr == ["arm: interrupted."]


@pytest.fixture
def rig_with_a_stage(tmp_path: Path) -> Path:
    """The test rig, and a stage at its endpoint."""
    folder = tmp_path / "test_rig"
    shutil.copytree(find_arm("test_rig").parent, folder)
    stage = yaml.safe_load((find_arm("five_axis").parent / "scenario.yaml").read_text(encoding="utf-8"))["stage"]
    with (folder / "scenario.yaml").open("a", encoding="utf-8") as scenario:
        scenario.write(yaml.safe_dump({"stage": stage}))
    return folder / "arm.yaml"


def test_a_controller_that_fails_is_quoted(output: Path, tmp_path: Path, rig_with_a_stage: Path) -> None:
    script = tmp_path / "controller.py"
    script.write_text("raise SystemExit('no idea what to do')\n", encoding="utf-8")
    options = ("--arm", str(rig_with_a_stage), "--arms", "0", "--seconds", "0.1", "--controller", str(script))
    with arm(output, *options) as program:
        assert exit_code(program) == 1
        assert program.stderr == ["controller: ended with exit code 1: no idea what to do."]


def test_a_wrong_command_line_ends_the_program(output: Path) -> None:
    with arm(output, "--arm", "six_fingers") as program:
        assert exit_code(program) == 2
        assert program.stdout == []
        (sentence,) = program.stderr
        assert sentence.startswith("arm 'six_fingers': no such arm; expected the path of an arm file, or one of ")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seconds", "0"], r"arm: argument --seconds: '0' is no duration, a number greater than 0; .*\."),
        (["--arms", "1"], r"arm: --arms 1; expected 0, or at least 2\."),
        (["--arms", "0", "--coverage-only"], r"arm: --coverage-only with --arms 0; expected at least 2 arms\."),
        (["--arm", "test_rig", "--controller", "x.py"], r".*scenario\.yaml: the scenario has no stage, .*\."),
        (["--controller", "nowhere.py"], r"arm: there is no file nowhere\.py; expected a Python program\."),
    ],
)
def test_a_wrong_command_line_is_one_sentence(
    output: Path, arguments: list[str], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["arm", "--output", str(output), *arguments]) == 2
    said, complaint = capfd.readouterr()
    assert said == ""
    assert re.fullmatch(sentence + "\n", complaint)
    assert not output.exists()

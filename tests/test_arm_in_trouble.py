"""The demo of the simulated arm in trouble: killed nodes, interruptions, wrong options."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.arms import arm, exit_code, nodes_of, nothing_left_of

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def output(tmp_path: Path) -> Iterator[Path]:
    """Return where the demo writes."""
    with nothing_left_of(tmp_path / "arm") as folder:
        yield folder


def test_a_killed_node_ends_the_demo_with_a_sentence(output: Path) -> None:
    with arm(output, "--arm", "test_rig", "--arms", "0", "--seconds", "60") as program:
        program.wait_for_line("truth ")
        victim = next(
            number
            for number in nodes_of(output)
            if "joint1.posor_node.log" in str(Path(f"/proc/{number}/fd/1").readlink())
        )
        os.kill(victim, signal.SIGKILL)
        assert exit_code(program) == 1
        (sentence,) = program.stderr
        assert sentence.startswith("joint1/posor_node: was ended by SIGKILL: ")


@pytest.mark.parametrize("moment", ["starting 3 nodes", "truth "])
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


def test_a_controller_that_fails_is_quoted(output: Path, tmp_path: Path) -> None:
    script = tmp_path / "controller.py"
    script.write_text("raise SystemExit('no idea what to do')\n", encoding="utf-8")
    with arm(output, "--arms", "0", "--seconds", "0.1", "--controller", str(script)) as program:
        assert exit_code(program) == 1
        assert program.stderr == ["controller: ended with exit code 1: no idea what to do."]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--arm", "six_fingers"], r"arm 'six_fingers': no such arm; expected the path of an arm file, or one of .*\."),
        (["--seconds", "0"], r"arm: argument --seconds: '0' is no duration, a number greater than 0; .*\."),
        (["--arms", "1"], r"arm: --arms 1; expected 0, or at least 2\."),
        (["--arms", "0", "--coverage-only"], r"arm: --coverage-only with --arms 0; expected at least 2 arms\."),
        (["--arm", "test_rig", "--controller", "x.py"], r".*scenario\.yaml: the scenario has no stage, .*\."),
        (["--controller", "nowhere.py"], r"arm: there is no file nowhere\.py; expected a Python program\."),
    ],
)
def test_a_wrong_command_line_is_one_sentence(output: Path, arguments: list[str], sentence: str) -> None:
    with arm(output, *arguments) as program:
        assert exit_code(program) == 2
        assert program.stdout == []
        assert len(program.stderr) == 1
        assert re.fullmatch(sentence, program.stderr[0])

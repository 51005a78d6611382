"""The demo of the simulated arm as its user starts it: a program that runs the five-axis arm, and its exit code."""

from __future__ import annotations

import json
import os
import re
import signal
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from posor_estimator.testing.program import Program, installed

if TYPE_CHECKING:
    from collections.abc import Iterator

CONTROLLER = Path(__file__).resolve().parents[1] / "examples" / "endpoint_controller" / "endpoint_controller.py"
PATIENCE_S = 110


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return where the demo writes; whatever still runs after the test and was told of that folder is ended."""
    monkeypatch.delenv("ROS_DOMAIN_ID")
    yield tmp_path / "arm"
    left = list(nodes_of(tmp_path / "arm"))
    for number in left:
        os.kill(number, signal.SIGKILL)
    assert left == []


def nodes_of(output: Path) -> Iterator[int]:
    """Yield the processes that write into the logs of an output folder."""
    for entry in Path("/proc").glob("[0-9]*/fd/1"):
        try:
            if str(output) in str(entry.readlink()):
                yield int(entry.parent.parent.name)
        except OSError:  # it has ended meanwhile
            continue


@contextmanager
def arm(output: Path, *arguments: str) -> Iterator[Program]:
    with Program([*installed("posor_bringup", "arm"), "--output", str(output), *arguments]) as program:
        try:
            yield program
        finally:
            if not program.ended:
                program.end()


def test_the_arm_runs_and_reports(output: Path) -> None:
    with arm(output, "--seconds", "1.5", "--arms", "0", "--controller", str(CONTROLLER)) as program:
        program.process.wait(PATIENCE_S)
        assert program.wait() == 0, program.stderr
        assert program.stderr == []
        assert program.stdout[-1] == "Everything holds."
        shown = [line for line in program.stdout if line.startswith("truth ")]
        assert len(shown) == 2  # once a second in both parts
        assert all(
            re.search(r"POSOR off [\d.]+ um, .* NEES [\d.]+ \(6 expected\); scans 200, ", line) for line in shown
        )
    assert sorted(path.name for path in output.iterdir()) == ["logs", "report.html", "report.png"]
    assert len(list((output / "logs").iterdir())) == 12
    figures = json.loads(output.with_name("arm.json").read_text(encoding="utf-8"))
    assert figures["ticks"]["recorded"] == 600
    assert figures["ticks"]["unaccounted"] == 0
    # The clock waits for every tick, however slow the machine is: only what the scenario drops or doubts is missing.
    causes = set(figures["ticks"]["without_pose_by_cause"])
    assert all(cause.endswith(("is lost (RESIDUAL)", "scan dropped, as the scenario has it")) for cause in causes)
    assert figures["ticks"]["with_pose"] >= 590
    errors = figures["endpoint_error_rms_m"]
    assert errors["posor"] < 2e-5
    assert 2e-4 < errors["encoder_only"] < 6e-4
    assert figures["controller"]["after_rms_m"] < 2e-5
    assert figures["controller"]["before_rms_m"] == pytest.approx(errors["encoder_only"], rel=0.05)
    assert set(figures["budget"]) == {"extended", "bent"}


def test_the_same_again_gives_the_same_figures(output: Path) -> None:
    found = []
    for name in ("one", "two"):
        with arm(output / name, "--arm", "test_rig", "--seconds", "0.5", "--arms", "0") as program:
            assert program.wait() == 0, program.stderr
        figures = json.loads((output / f"{name}.json").read_text(encoding="utf-8"))
        found.append({key: value for key, value in figures.items() if key != "budget"})
    assert found[0] == found[1]


def test_a_killed_node_ends_the_demo_with_a_sentence(output: Path) -> None:
    with arm(output, "--arm", "test_rig", "--arms", "0", "--seconds", "60") as program:
        program.wait_for_line("truth ")
        victim = next(
            number
            for number in nodes_of(output)
            if "joint1.posor_node.log" in str(Path(f"/proc/{number}/fd/1").readlink())
        )
        os.kill(victim, signal.SIGKILL)
        assert program.wait() == 1
        (sentence,) = program.stderr
        assert sentence.startswith("joint1/posor_node: was ended by SIGKILL: ")


@pytest.mark.parametrize("moment", ["starting 3 nodes", "truth "])
def test_an_interrupted_demo_leaves_nothing_behind(output: Path, moment: str) -> None:
    with arm(output, "--arm", "test_rig", "--arms", "0", "--seconds", "60") as program:
        program.wait_for_line(moment)
        assert program.end() == 130
        assert program.stderr == ["arm: interrupted."]


def test_drawing_arms_needs_no_node_and_can_be_interrupted(output: Path) -> None:
    with arm(output, "--arm", "test_rig", "--coverage-only", "--arms", "20") as program:
        assert program.wait() == 0, program.stderr
    figures = json.loads(output.with_name("arm.json").read_text(encoding="utf-8"))
    assert figures["coverage"]["arms"] == 20
    assert 0.8 <= figures["coverage95"] <= 1.0
    assert "endpoint_error_rms_m" not in figures
    with arm(output, "--arm", "test_rig", "--coverage-only", "--arms", "100000") as program:
        program.wait_for_line("drawing 100000 arms")
        assert program.end() == 130
        assert program.stderr == ["arm: interrupted."]


def test_a_controller_that_fails_is_quoted(output: Path, tmp_path: Path) -> None:
    script = tmp_path / "controller.py"
    script.write_text("raise SystemExit('no idea what to do')\n", encoding="utf-8")
    with arm(output, "--arms", "0", "--seconds", "0.1", "--controller", str(script)) as program:
        assert program.wait() == 1
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
        assert program.wait() == 2
        assert program.stdout == []
        assert len(program.stderr) == 1
        assert re.fullmatch(sentence, program.stderr[0])

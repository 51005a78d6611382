"""The demo of the simulated arm as its user starts it: a program that runs the five-axis arm, and its exit code."""

from __future__ import annotations

import json
import re
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.arms import arm, exit_code, nothing_left_of

if TYPE_CHECKING:
    from collections.abc import Iterator

CONTROLLER = Path(__file__).resolve().parents[1] / "examples" / "endpoint_controller" / "endpoint_controller.py"
pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def output(tmp_path: Path) -> Iterator[Path]:
    """Return where the demo writes."""
    with nothing_left_of(tmp_path / "arm") as folder:
        yield folder


def test_the_arm_runs_and_reports(output: Path) -> None:
    with arm(output, "--seconds", "1", "--arms", "0", "--controller", str(CONTROLLER)) as program:
        assert exit_code(program) == 0, program.stderr
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
    assert figures["ticks"]["recorded"] == 400
    assert figures["ticks"]["unaccounted"] == 0
    # The clock waits for every tick, however slow the machine is: only what the scenario drops or doubts is missing.
    causes = set(figures["ticks"]["without_pose_by_cause"])
    assert all(cause.endswith(("is lost (RESIDUAL)", "scan dropped, as the scenario has it")) for cause in causes)
    assert figures["ticks"]["with_pose"] >= 393
    errors = figures["endpoint_error_rms_m"]
    assert errors["posor"] < 2e-5
    assert 2e-4 < errors["encoder_only"] < 6e-4
    assert figures["controller"]["after_rms_m"] < 2e-5
    assert figures["controller"]["before_rms_m"] == pytest.approx(errors["encoder_only"], rel=0.05)
    assert set(figures["budget"]) == {"extended", "bent"}


def test_the_same_again_gives_the_same_figures(output: Path) -> None:
    names = ("one", "two")
    with ExitStack() as stack:
        options = ("--arm", "test_rig", "--seconds", "0.25", "--arms", "0")
        for program in [stack.enter_context(arm(output / name, *options)) for name in names]:
            assert exit_code(program) == 0, program.stderr
    found = []
    for name in names:
        figures = json.loads((output / f"{name}.json").read_text(encoding="utf-8"))
        found.append({key: value for key, value in figures.items() if key != "budget"})
    assert found[0] == found[1]


def test_drawing_arms_needs_no_node(output: Path) -> None:
    with arm(output, "--arm", "test_rig", "--coverage-only", "--arms", "20") as program:
        assert exit_code(program) == 0, program.stderr
    figures = json.loads(output.with_name("arm.json").read_text(encoding="utf-8"))
    assert figures["coverage"]["arms"] == 20
    assert 0.8 <= figures["coverage95"] <= 1.0
    assert "endpoint_error_rms_m" not in figures

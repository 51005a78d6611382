# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The program ``arm``: figures, files, exit codes, interruptions, killed nodes, wrong options."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from posor.arm_names import find_arm
from posor_lab.arm_study.arm_command import main
from posor_lab.harness.program import Program, installed

CONTROLLER = Path(__file__).resolve().parents[1] / "examples" / "endpoint_controller" / "endpoint_controller.py"
RUNNING = "without controller"  # printed when the ticks begin
TIMEOUT_S = 250


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the output folder; check after the test that no process writes into it."""
    monkeypatch.delenv("ROS_DOMAIN_ID")  # the program chooses its own domain
    yield tmp_path / "arm"
    left = list(node_processes(tmp_path / "arm"))
    for number in left:
        os.kill(number, signal.SIGKILL)
    assert left == []


def node_processes(output: Path) -> Iterator[int]:
    """Yield the processes that write into the logs of an output folder."""
    for entry in Path("/proc").glob("[0-9]*/fd/1"):
        try:
            if str(output) in str(entry.readlink()):
                yield int(entry.parent.parent.name)
        except OSError:  # the process has ended
            continue


@contextmanager
def run_arm(output: Path, *arguments: str) -> Iterator[Program]:
    with Program([*installed("posor_lab", "arm"), "--output", str(output), *arguments]) as program:
        try:
            yield program
        finally:
            if not program.ended:
                program.end()


def exit_code(program: Program) -> int:
    program.process.wait(TIMEOUT_S)
    return program.wait()


@pytest.mark.long
def test_arm_runs_and_reports(output: Path) -> None:
    with run_arm(output, "--seconds", "1", "--arms", "0", "--controller", str(CONTROLLER)) as program:
        assert exit_code(program) == 0, program.stderr
        assert program.stderr == []
        assert program.stdout[-1] == "Everything holds."
        shown = [line for line in program.stdout if line.startswith("truth ")]
        assert len(shown) == 2  # once a second in both parts
        assert all(
            re.search(r"POSOR off [\d.]+ um, .* NEES [\d.]+ \(6 expected\); scans 200, ", line) for line in shown
        )
    assert sorted(path.name for path in output.iterdir()) == [".results.json", "logs", "report.html"]
    assert len(list((output / "logs").iterdir())) == 12
    figures = json.loads(output.with_name("arm.json").read_text(encoding="utf-8"))
    assert figures["ticks"]["recorded"] == 400
    assert figures["ticks"]["unaccounted"] == 0
    # The clock waits for every tick: only scans that the scenario drops or that fail the chi-square test are missing.
    causes = set(figures["ticks"]["without_pose_by_cause"])
    assert all(cause.endswith(("is lost (RESIDUAL)", "scan dropped by the scenario")) for cause in causes)
    assert figures["ticks"]["with_pose"] >= 393
    errors = figures["endpoint_error_rms_m"]
    assert errors["posor"] < 2e-5
    assert 2e-4 < errors["encoder_only"] < 6e-4
    assert figures["controller"]["after_rms_m"] < 2e-5
    assert figures["controller"]["before_rms_m"] == pytest.approx(errors["encoder_only"], rel=0.05)
    assert set(figures["budget"]) == {"extended", "bent"}


@pytest.mark.long
def test_same_run_gives_the_same_figures(output: Path) -> None:
    names = ("one", "two")
    with ExitStack() as stack:
        options = ("--arm", "test_rig", "--seconds", "0.25", "--arms", "0")
        for program in [stack.enter_context(run_arm(output / name, *options)) for name in names]:
            assert exit_code(program) == 0, program.stderr
    found = []
    for name in names:
        figures = json.loads((output / f"{name}.json").read_text(encoding="utf-8"))
        found.append({key: value for key, value in figures.items() if key != "budget"})
    assert found[0] == found[1]


@pytest.mark.long
def test_coverage_needs_no_nodes(output: Path) -> None:
    with run_arm(output, "--arm", "test_rig", "--coverage-only", "--arms", "20") as program:
        assert exit_code(program) == 0, program.stderr
    figures = json.loads(output.with_name("arm.json").read_text(encoding="utf-8"))
    assert figures["coverage"]["arms"] == 20
    assert 0.8 <= figures["coverage95"] <= 1.0
    assert "endpoint_error_rms_m" not in figures


def changed_rig(folder: Path, changes: Mapping[str, Any]) -> str:
    """Return a copy of the test rig with other entries in its scenario."""
    shutil.copytree(find_arm("test_rig").parent, folder)
    path = folder / "scenario.yaml"
    scenario = yaml.safe_load(path.read_text(encoding="utf-8"))
    path.write_text(yaml.safe_dump({**scenario, **changes}), encoding="utf-8")
    return str(folder)


def entry_of(arm: str, name: str) -> Any:
    return yaml.safe_load((find_arm(arm).parent / "scenario.yaml").read_text(encoding="utf-8"))[name]


@pytest.mark.long
def test_a_scenario_without_latency_runs(output: Path, tmp_path: Path) -> None:
    electronics = {name: value for name, value in entry_of("test_rig", "electronics").items() if name != "latency"}
    rig = changed_rig(tmp_path / "rig", {"electronics": electronics})
    with run_arm(output, "--arm", rig, "--arms", "0", "--seconds", "1") as program:
        assert exit_code(program) == 0
        assert any("none unaccounted for; 200 with a pose" in line for line in program.stdout)


@pytest.mark.long
def test_killed_node_ends_the_program_with_a_message(output: Path) -> None:
    with run_arm(output, "--arm", "test_rig", "--arms", "0", "--seconds", "60") as program:
        program.wait_for_line(RUNNING)
        victim = next(
            number
            for number in node_processes(output)
            if "joint1.posor_node.log" in str(Path(f"/proc/{number}/fd/1").readlink())
        )
        os.kill(victim, signal.SIGKILL)
        assert exit_code(program) == 1
        (sentence,) = program.stderr
        assert sentence.startswith("joint1/posor_node: was ended by SIGKILL; log: ")


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "moment"),
    [
        (("--arms", "0", "--seconds", "60"), "starting 3 nodes"),
        (("--arms", "0", "--seconds", "60"), RUNNING),
        (("--coverage-only", "--arms", "100000"), "drawing 100000 arms"),
    ],
)
def test_interruption_leaves_no_process(output: Path, options: tuple[str, ...], moment: str) -> None:
    with run_arm(output, "--arm", "test_rig", *options) as program:
        program.wait_for_line(moment)
        assert program.end() == 130
        assert program.stderr == ["arm: interrupted."]


@pytest.mark.long
def test_message_of_a_failed_controller_is_quoted(output: Path, tmp_path: Path) -> None:
    script, rig = tmp_path / "controller.py", changed_rig(tmp_path / "rig", {"stage": entry_of("five_axis", "stage")})
    script.write_text("raise SystemExit('no idea what to do')\n", encoding="utf-8")
    options = ("--arm", rig, "--arms", "0", "--seconds", "0.1", "--controller", str(script))
    with run_arm(output, *options) as program:
        assert exit_code(program) == 1
        assert program.stderr == ["controller: ended with exit code 1: no idea what to do."]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--arm", "six_fingers"], r"arm 'six_fingers': no such arm; .*\."),
        (["--seconds", "0"], r"arm: argument --seconds: '0' is not a number of more than 0 s; .*\."),
        (["--arms", "1"], r"arm: --arms 1; expected 0, or at least 2\."),
        (["--arms", "0", "--coverage-only"], r"arm: --coverage-only with --arms 0; expected at least 2 arms\."),
        (["--arm", "test_rig", "--controller", "x.py"], r".*scenario\.yaml: the scenario has no stage, .*\."),
        (["--controller", "nowhere.py"], r"arm: there is no file nowhere\.py; expected a Python program\."),
    ],
)
def test_wrong_option_is_refused_with_one_sentence(
    output: Path, arguments: list[str], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["arm", "--output", str(output), *arguments]) == 2
    printed, error = capfd.readouterr()
    assert all(line.endswith(": preparing the simulation") for line in printed.splitlines())
    assert re.fullmatch(sentence + "\n", error)
    assert not output.exists()

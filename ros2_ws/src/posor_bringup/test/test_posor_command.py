# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor: one command that starts the programs; a wrong subcommand is one sentence."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest
from posor.lazy_program import LazyProgram
from posor_bringup.posor_command import SUBCOMMANDS, main, words_after
from posor_lab.harness.program import installed

ROOT = Path(__file__).resolve().parents[4]


def posor(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*installed("posor_bringup", "posor"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)])
def test_posor_lists_its_subcommands(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, subcommand in SUBCOMMANDS.items():
        assert [line.split(maxsplit=1) for line in lines if line.startswith(f"  {name} ")] == [
            [name, subcommand.summary]
        ]


def test_every_subcommand_has_a_program() -> None:
    programs = [each.program for each in SUBCOMMANDS.values() if isinstance(each.program, LazyProgram)]
    assert len(programs) == len(SUBCOMMANDS) - 1
    for program in programs:
        assert find_spec(program.module), program.module


def test_arguments_and_exit_code_are_those_of_the_program(tmp_path: Path) -> None:
    done = posor("check", str(tmp_path / "none.yaml"), str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.startswith(f"calibration file {tmp_path}/none.yaml: cannot be read")
    done = posor("calibrate", "--surprise")
    assert done.returncode == 2
    assert done.stderr.startswith("calibrate: ")


@pytest.mark.parametrize(
    ("name", "expected"),
    [("calibrat", "perhaps 'calibrate'"), ("chek", "perhaps 'check'"), ("xyz", f"one of {', '.join(SUBCOMMANDS)}")],
)
def test_an_unknown_subcommand_is_one_sentence(name: str, expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "more"]) == 2
    assert capsys.readouterr().err == f"posor: there is no subcommand '{name}'; expected {expected}.\n"


@pytest.mark.parametrize(
    ("words", "expected", "missing"),
    [
        (("bringup",), {"five_axis", "--layout", "--params-file", "composed"}, {"bundle"}),
        (("arm",), {"new", "check", "--help"}, {"--joints"}),
        (("arm", "new"), {"--joints", "--sensors"}, {"--params-file"}),
        (("arm", "check"), {"test_rig", "--params-file"}, {"--joints"}),
        (("calibrate",), {"bundle", "list", "diff"}, {"five_axis"}),
        (("calibrate", "bundle"), {"--parameters", "--output"}, {"list"}),
        (("bringup", "five_axis"), {"--layout"}, {"bundle"}),
        (("design",), {"posor", "arm"}, {"five_axis"}),
        *(((name,), {"five_axis", "--arm"}, {"bundle"}) for name in ("reprocess", "import", "record", "budget")),
        *(
            (words, {"five_axis"}, {"bundle"})
            for words in (("design", "arm"), ("instruments", "start"), ("statement",))
        ),
    ],
)
def test_options_arms_and_procedures_are_completed(
    words: tuple[str, ...], expected: set[str], missing: set[str]
) -> None:
    found = set(words_after(*words))
    assert expected <= found
    assert not missing & found


def test_bash_asks_for_the_words_of_a_subcommand_once(tmp_path: Path) -> None:
    program = tmp_path / "posor"
    program.write_text(f"#!/bin/sh\necho asked >> {tmp_path}/log\necho five_axis six_axis --layout\n", encoding="utf-8")
    program.chmod(0o755)
    script = posor("completion").stdout + (
        f'complete_it() {{ COMP_WORDS=({program} "$@"); COMP_CWORD=$#; '
        f'_posor {program} "${{!#}}" x; echo "${{COMPREPLY[*]}}"; }}\n'
        "complete_it re; complete_it bringup six; complete_it bringup ''; complete_it bringup six_axis --; "
        "complete -p posor"
    )
    done = subprocess.run(["/bin/bash", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "record reprocess recover",
        "six_axis",
        "five_axis six_axis --layout",
        "--layout",
        "complete -o default -F _posor posor",
    ]
    assert (tmp_path / "log").read_text(encoding="utf-8") == 2 * "asked\n"


def test_a_full_disk_of_standard_output_is_one_sentence() -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        code = "from posor_bringup.bringup_programs import arm; import sys; sys.argv = ['arm', 'check', 'test_rig']; "
        done = subprocess.run(
            [sys.executable, "-c", f"{code}sys.exit(arm())"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stderr.endswith("no space left on device; expected free space on the disk.\n")


def test_the_script_in_the_root_starts_posor() -> None:
    script = ROOT / "posor"
    assert script.stat().st_mode & 0o111
    assert 'run" posor_bringup posor "$@"' in script.read_text(encoding="utf-8")

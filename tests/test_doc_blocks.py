# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every code block of every page is run or loaded, or is marked as an excerpt by its first line.

The first line of an excerpt is ``# excerpt``, or ``# excerpt of a calibration file``, which is loaded as part of one.
Blocks of ``text`` are formulas, drawings and output. ``test_tutorials`` runs the tutorials. Options and parameters of
all commands are checked; those that need no device and run in seconds are run.
"""

from __future__ import annotations

import argparse
import ast
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import distribution
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from environment import THIS
from markdown_it import MarkdownIt
from posor.arm_names import find_arm
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import design
from posor.calibration.yaml_document import parse_document, parse_yaml
from posor.chain.arm_file import ArmFileContent
from posor.chain.beams_file import BeamsFile
from posor.lazy_program import LazyProgram
from posor.node_parameters import ChainParameters, PosorParameters
from posor.parameter_model import parameter_specs
from posor.tables.table_map import TableMap
from posor_bringup.posor_command import SUBCOMMANDS
from posor_drivers.driver_parameters import driver_parameters_for
from posor_drivers.instruments.instruments_file import InstrumentsFile
from posor_drivers.instruments.scpi_device import Dialect
from posor_estimator.composition_file import Composition
from posor_estimator.correction_node import CorrectionParameters
from posor_lab.harness.rig_files import calibration_path
from posor_ros.qos_overrides import PREFIX

EXCERPT = "# excerpt"
OF_CALIBRATION = f"{EXCERPT} of a calibration file"
LANGUAGES = {"sh", "python", "yaml", "text"}
FORMATS: dict[str, Callable[[dict[str, Any]], object]] = {
    "posor_arm": ArmFileContent.model_validate,
    "posor_beams": BeamsFile.model_validate,
    "posor_calibration": calibration_from,
    "posor_composition": Composition.model_validate,
    "posor_instruments": InstrumentsFile.model_validate,
    "posor_scpi_dialect": Dialect.model_validate,
    "posor_table_map": TableMap.model_validate,
}
VERSIONS = (1, 2, 3, 4)
EXTERNAL = {
    *(".", "cd", "done", "echo", "eval", "export", "for", "kill", "sleep", "source", "until", "wait"),
    *("cat", "cp", "grep", "head", "journalctl", "ls", "mkdir", "rm", "sed", "systemctl", "timeout", "true"),
    *("apt", "docker", "pip", "python", "ros2", "rosdep"),
}
"""Programs of the shell, the system and ROS."""
PREFIXES = {"sudo"}
NODES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "chain_node": lambda _: ChainParameters,
    "compose": lambda _: PosorParameters,
    "correction_node": lambda _: CorrectionParameters,
    "driver_node": driver_parameters_for,
    "posor_node": lambda _: PosorParameters,
}
"""Programs whose arguments are those of ROS, and the models of their parameters."""
OFFLINE = re.compile(r"posor (arm|calibrate (list|diff)|design aero|instruments start|reprocess bags)\b.*")
"""Commands that run in seconds with what the workspace has."""


class Block(NamedTuple):
    """A code block: page and line, language, text."""

    page: str
    line: int
    language: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.page}:{self.line}"


def all_blocks() -> list[Block]:
    listing = subprocess.run(["git", "ls-files", "*.md"], cwd=THIS.root, capture_output=True, text=True, check=True)  # noqa: S607
    pages = [name for name in listing.stdout.splitlines() if (THIS.root / name).is_file()]
    tokens = [(name, each) for name in pages for each in MarkdownIt().parse((THIS.root / name).read_text("utf-8"))]
    return [
        Block(name, each.map[0] + 1, each.info if each.type == "fence" else "(indented)", each.content)
        for name, each in tokens
        if each.type in ("fence", "code_block") and each.map and not each.info.startswith("{")
    ]


BLOCKS = all_blocks()


def of(language: str, *, is_excerpt: bool = False, tutorials: bool = True) -> list[Block]:
    found = [block for block in BLOCKS if block.language == language]
    found = [block for block in found if tutorials or "docs/tutorials/" not in block.page]
    return [block for block in found if block.text.startswith(EXCERPT) == is_excerpt]


def each(blocks: list[Block]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("block", blocks, ids=[block.name for block in blocks])


def test_every_block_states_a_language_that_is_checked() -> None:
    assert not [block.name for block in BLOCKS if block.language not in LANGUAGES]


@each(of("yaml"))
def test_file_is_loaded(block: Block) -> None:
    content: Any = parse_yaml(block.text, block.name)[1]
    assert content.get("format") in FORMATS, f"a file that is loaded, or the first line '{EXCERPT}'"
    parse_document(block.text, block.name, "", VERSIONS, FORMATS[content["format"]])


@each(of("yaml", is_excerpt=True))
def test_excerpt_of_a_file_is_loaded(block: Block) -> None:
    content: Any = parse_yaml(block.text, block.name)[1]
    if block.text.startswith(OF_CALIBRATION):
        whole = design("quad_bumpy_ring").model_dump(mode="json", exclude_defaults=True)
        calibration_from({**whole, **content})


@each(of("python", tutorials=False))
def test_python_runs(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(THIS.root)
    exec(compile(block.text, block.name, "exec"), {"__name__": "__main__"})  # noqa: S102


@each(of("python", is_excerpt=True))
def test_excerpt_of_python_imports_what_exists(block: Block) -> None:
    try:
        tree = ast.parse(block.text)
    except IndentationError:
        tree = ast.parse(f"if True:\n{block.text}")
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            module = import_module(str(node.module))
            assert not [name.name for name in node.names if not hasattr(module, name.name)]


class ParsedError(BaseException):
    """Raised in place of running a program whose command line is valid."""


def parse(program: LazyProgram, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse the arguments of a program by its own parser, without running it."""
    original = argparse.ArgumentParser.parse_args

    def parse_only(parser: argparse.ArgumentParser, *given: Any, **named: Any) -> None:
        original(parser, *given, **named)
        raise ParsedError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_only)
    monkeypatch.setattr(sys, "argv", [program.name, *arguments])
    with pytest.raises(ParsedError):
        import_module(program.module).main()


def program_of(package: str, executable: str) -> LazyProgram:
    [entry] = [
        entry
        for entry in distribution(package).entry_points
        if (entry.group, entry.name) == ("console_scripts", executable)
    ]
    loaded = entry.load()
    assert isinstance(loaded, LazyProgram)
    return loaded


def check_parameters(program: str, arguments: list[str]) -> None:
    """Check the names of the parameters of a node."""
    given = [value.partition(":=") for option, value in pairwise(arguments) if option == "-p"]
    parameters = {name: yaml.safe_load(value) for name, _, value in given if not name.startswith(PREFIX)}
    model = NODES[program]({"source": "simulated", **parameters})
    assert all(equals for _, equals, _ in given)
    assert not parameters.keys() - {spec.name for spec in parameter_specs(model)}


def check_command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    while words and (re.match(r"\w+=", words[0]) or words[0] in PREFIXES):
        words = words[1:]
    if not words:
        return
    command, *arguments = words
    if command == "./posor":
        name, *arguments = arguments
        subcommand: Any = SUBCOMMANDS[name]
        parse(subcommand.program, [*subcommand.arguments, *arguments], monkeypatch)
        if name == "bringup":
            check_parameters("driver_node", arguments)
    elif command == "./run":
        program = program_of(arguments[0], arguments[1])
        if program.name in NODES:
            check_parameters(program.name, arguments[2:])
        else:
            parse(program, arguments[2:], monkeypatch)
    elif command == "make":
        makefile = (THIS.root / "Makefile").read_text(encoding="utf-8")
        target, *variables = arguments
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
        assert not [each for each in variables if f"$({each.partition('=')[0]}" not in makefile]
    elif "/" in command:
        assert (THIS.root / command).exists() or command == ".venv/bin/python", command
        scripts = [each for each in arguments if each.startswith(("tools/", "examples/")) and each.endswith(".py")]
        assert not [each for each in scripts if not (THIS.root / each).is_file()]
    else:
        assert command in EXTERNAL, command


def commands_of(text: str) -> list[list[str]]:
    """Return the words of each simple command of a script."""
    found: list[list[str]] = []
    text = re.sub(r"<<\s*'?(\w+)'?(.*\n)(?:.*\n)*?\1\n", r"\2", text)  # texts between a word and its repetition
    for line in re.sub(r"\$\([^)]*\)", "text", text.replace("\\\n", " ")).splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|<>")
        lexer.whitespace_split, lexer.commenters = True, ""
        lexer.wordchars += "#"
        words: list[str] = []
        for word in lexer:
            if word.startswith("#"):
                break
            if word in (";", "&", "&&", "||", "|"):
                found.append(words)
                words = []
            elif re.fullmatch(r"[<>]+", word):
                words.append("\0")
            elif words and words[-1] == "\0":
                words.pop()  # the file of a redirection
            elif word not in ("do", "then", "[", "]"):
                words.append(word)
        found.append(words)
    return [words for words in found if words]


@each(of("sh"))
def test_commands_exist_and_have_these_options(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    for words in commands_of(block.text):
        with monkeypatch.context() as context:
            check_command(words, context)


def offline_commands(block: Block) -> list[list[str]]:
    """Return the commands of a block that are run: program and arguments."""
    commands = [words[words[0] == "./run" :] for words in commands_of(block.text) if words[0] in ("./posor", "./run")]
    commands = [[words[0].removeprefix("./"), *words[1:]] for words in commands]
    return [words for words in commands if OFFLINE.fullmatch(" ".join(words))]


@each([block for block in of("sh", tutorials=False) if offline_commands(block)])
def test_commands_that_need_no_device_run(block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("bags", "ros2_ws"):
        (tmp_path / name).symlink_to(THIS.root / name)
    for name in ("in.yaml", "out.yaml"):
        (tmp_path / name).symlink_to(calibration_path("printed"))
    if "arm new" not in block.text:
        (tmp_path / "my_arm").symlink_to(find_arm("five_axis").parent)
    monkeypatch.chdir(tmp_path)
    for _, name, *arguments in offline_commands(block):
        program: Any = SUBCOMMANDS[name].program
        monkeypatch.setattr(sys, "argv", [program.name, *arguments])
        assert import_module(program.module).main() == 0

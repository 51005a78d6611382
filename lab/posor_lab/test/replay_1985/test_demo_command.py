# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options and output folder of the demo."""

from __future__ import annotations

from pathlib import Path

import pytest
from posor.errors import OutputError
from posor_bringup.bringup_options import prepare_output_folder
from posor_lab.replay_1985.demo_command import OUTPUT_FILES, main, parse_options


def test_defaults_are_those_of_make_demo() -> None:
    options = parse_options([])
    assert (options.bag, options.calibration, options.rate, options.no_live) == ("ymo", "printed", 1.0, False)
    assert options.output == Path("build/report")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--bag", "gen"], "demo: argument --bag: invalid choice: 'gen' (choose from"),
        (["--calibration", "1985"], "demo: argument --calibration: invalid choice: '1985' (choose from"),
        (["--rate", "-1"], "demo: --rate -1; expected 0 to 1e+06."),
        (["--rate", "fast"], "demo: argument --rate: invalid float value: 'fast'"),
        (["--speed", "2"], "demo: unrecognized arguments: --speed 2"),
        (["--ros-args", "-p"], "ROS arguments: cannot be understood"),
    ],
)
def test_an_invalid_option_is_refused_in_one_line(
    arguments: list[str], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", *arguments]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith(sentence)
    assert err.endswith(".\n")
    assert err.count("\n") == 1


def test_an_output_that_cannot_be_created_is_refused_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["demo", "--output", str(tmp_path / "file")]) == 1
    err = capfd.readouterr().err
    assert err == f"{tmp_path / 'file' / 'ymo_printed'}: cannot be written, Not a directory.\n"


def test_an_earlier_report_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    for _ in range(2):
        assert prepare_output_folder(tmp_path, OUTPUT_FILES) == tmp_path
        assert not list((tmp_path / "logs").iterdir())
        assert sorted(path.name for path in tmp_path.iterdir() if path.name[0] != ".") in (
            ["logs"],
            ["logs", "my notes.txt"],
        )
        for name in ("report.html", "steps.csv", "bag/bag_0.mcap", "logs/record.log", "my notes.txt"):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).touch()


@pytest.mark.parametrize("name", ["logs/mine.txt", "report.html", "bag/bag_0.mcap"])
def test_what_no_earlier_run_has_made_is_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    entry = name.split("/", maxsplit=1)[0]
    with pytest.raises(OutputError, match=f"holds {entry}, which is not marked as a result; expected another name"):
        prepare_output_folder(tmp_path, OUTPUT_FILES)
    assert (tmp_path / name).read_text() == "mine"


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report").touch()
    with pytest.raises(OutputError):
        prepare_output_folder(tmp_path / "report", OUTPUT_FILES)

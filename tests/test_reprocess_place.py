# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where reprocess writes: never over recordings, nor over anything else that is not marked as its results."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet
import pytest
from posor.bags.reprocess_command import main
from posor.bags.result_folder import FORMER, MARK, NEW, UNFINISHED, clear_unfinished
from posor_lab.harness.rig_files import calibration_path

BAGS = Path(__file__).resolve().parents[1] / "bags"
CALIBRATION = ["--calibration", f"joint1={calibration_path('printed')}"]
FORCE = pytest.mark.parametrize("force", [[], ["--force"]], ids=["", "force"])


@pytest.fixture
def bags(tmp_path: Path) -> Path:
    for name in ("ymo", "zmo"):
        shutil.copytree(BAGS / name, tmp_path / "day" / name)
    return tmp_path / "day"


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return what runs the program, which refuses and changes nothing, and returns its sentence."""

    def run(*arguments: str | Path) -> str:
        before = contents(tmp_path)
        assert main([str(argument) for argument in [*arguments, *CALIBRATION]]) == 1
        assert contents(tmp_path) == before
        said = capsys.readouterr().err.removesuffix("\n")
        assert "\n" not in said
        return said

    return run


def contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


@FORCE
@pytest.mark.parametrize("kind", ["bag", "csv"])
def test_a_bag_does_not_replace_itself(force: list[str], kind: str, bags: Path, refused: Callable[..., str]) -> None:
    bag = bags / "ymo"
    said = refused(bag, "--output", bag, "--format", kind, *force)
    assert said == f"{bag}: is bag {bag}, which is to be read; expected a place outside of it."


@FORCE
def test_a_bag_does_not_replace_itself_by_its_file_or_a_link(
    force: list[str], bags: Path, refused: Callable[..., str]
) -> None:
    (bags / "link").symlink_to("ymo")
    file = bags / "ymo" / "ymo_0.mcap"
    assert "ymo: is bag" in refused(file, "--output", bags / "ymo", *force)
    assert "link: is bag" in refused(bags / "ymo", "--output", bags / "link", *force)
    assert "ymo: is bag" in refused(bags / "link", "--output", bags / "ymo", *force)
    assert "ymo_0.mcap: lies in bag" in refused(file, "--output", file, *force)


@FORCE
def test_a_bag_does_not_replace_a_folder_around_or_in_it(
    force: list[str], bags: Path, refused: Callable[..., str]
) -> None:
    bag = bags / "ymo"
    assert refused(bag, "--output", bags, *force).startswith(
        f"{bags}: holds bag {bag}, which is to be read; expected a"
    )
    assert "new: lies in bag" in refused(bag, "--output", bag / "new", *force)
    assert "new: lies in bag" in refused(bag / "ymo_0.mcap", "--output", bag / "new", *force)


@FORCE
def test_several_bags_do_not_replace_themselves_or_one_another(
    force: list[str], bags: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert "ymo: is bag" in refused(bags / "ymo", bags / "zmo", "--output", bags, *force)
    other = shutil.copytree(BAGS / "yzmo", tmp_path / "other" / "yzmo")
    assert "zmo/yzmo: lies in bag" in refused(other, bags / "zmo", "--output", bags / "zmo", *force)


def test_a_file_without_a_bag_around_it_has_results_beside_it(bags: Path) -> None:
    file = bags / "alone.mcap"
    shutil.copy(bags / "ymo" / "ymo_0.mcap", file)
    assert main([str(file), *CALIBRATION, "--output", str(bags / "out")]) == 0
    assert (bags / "out" / "out_0.mcap").is_file()


@FORCE
def test_unmarked_files_are_not_replaced(
    force: list[str], bags: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def there(name: str) -> str:
        said = refused(bags / "ymo", "--output", tmp_path / name, *force)
        assert "--force" not in said
        return said.removeprefix(f"{tmp_path}/")

    table = pa.table({"x": [1.0]})
    for name in ("csv", "parquet", "nested"):
        (tmp_path / name).mkdir()
    (tmp_path / "csv" / "joint1.csv").write_text("x\n1\n")
    pa.parquet.write_table(table, tmp_path / "parquet" / "joint1.parquet")
    (tmp_path / "nested" / "joint1").mkdir()
    (tmp_path / "file").write_text("x")
    unmarked = "which is not marked as a result; expected another name."
    assert there("day/zmo") == f"day/zmo: holds metadata.yaml, {unmarked}"
    assert there("csv") == f"csv: holds joint1.csv, {unmarked}"
    assert there("parquet") == f"parquet: holds joint1.parquet, {unmarked}"
    assert there("nested") == f"nested: holds joint1, {unmarked}"
    assert there("file") == "file: is no folder of results; expected another name."


@FORCE
@pytest.mark.parametrize("kind", ["bag", "parquet", "csv"])
def test_results_that_have_been_changed_are_not_replaced(
    force: list[str], kind: str, bags: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    out = tmp_path / "out"
    again = [bags / "ymo", "--output", out, *force]
    assert main([str(bags / "ymo"), *CALIBRATION, "--output", str(out), "--format", kind]) == 0
    (out / "thesis.tex").touch()
    assert "out: holds thesis.tex, which is not marked as a result; expected another name." in refused(*again)
    (out / "thesis.tex").unlink()
    result = max(out.iterdir(), key=lambda path: path.stat().st_size)
    whole = result.read_bytes()
    result.write_bytes(whole + b"0")
    assert f"out: holds {result.name}, which" in refused(*again)
    result.unlink()
    (tmp_path / "elsewhere").write_bytes(whole)
    result.symlink_to(tmp_path / "elsewhere")
    assert f"out: holds {result.name}, which" in refused(*again)
    for mark in ("", "[]", "{}", '{"results": 1}'):
        (out / MARK).write_text(mark)
        assert f"out: holds {MARK}, which" in refused(*again)
    (out / MARK).unlink()
    assert "which is not marked" in refused(*again)


@pytest.mark.parametrize("kind", ["bag", "parquet", "csv"])
def test_results_are_replaced_only_with_force(
    kind: str, bags: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    out = tmp_path / "out"
    again = [str(bags / "ymo"), "--output", str(out), "--format", "csv"]
    assert main([*again[:3], "--format", kind, *CALIBRATION]) == 0
    listed = json.loads((out / MARK).read_text())["results"]
    assert listed == {path.name: path.stat().st_size for path in out.iterdir() if path.name != MARK}
    assert refused(*again) == f"{out}: exists already; expected another name, or --force to replace it."
    assert main([*again, "--force", *CALIBRATION]) == 0
    assert sorted(path.name for path in out.iterdir()) == [MARK, "joint1.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["day", "out"]


def test_an_empty_folder_is_replaced_with_force(bags: Path, tmp_path: Path) -> None:
    (tmp_path / "former").mkdir()
    assert main([str(bags / "ymo"), *CALIBRATION, "--output", str(tmp_path / "former"), "--force"]) == 0
    assert main([str(bags / "ymo"), *CALIBRATION, "--output", str(tmp_path / "former"), "--force"]) == 0
    assert (tmp_path / "former" / "former_0.mcap").is_file()


def test_only_leftovers_of_this_run_are_cleared_and_former_results_go_back(tmp_path: Path) -> None:
    for run in ("a", "a-b", "ab"):
        for folder in (f"{NEW}/out", f"{FORMER}/{run}"):
            (tmp_path / f"{UNFINISHED}{run}-x" / folder).mkdir(parents=True)
    clear_unfinished(tmp_path, "ab")
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{UNFINISHED}a-b-x", f"{UNFINISHED}a-x", "ab"]

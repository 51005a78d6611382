# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Changing a calibration file: what is replaced, what stays, and what is never lost."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.calibration.edit import edit_document, parse_key_path
from posor.calibration.save import refuse_existing, save_calibration, save_files
from posor.calibration.yaml_document import FastLoader, StrictLoader, parse_yaml
from posor.errors import CalibrationError
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.full_disk import contents_of, full_disk_changes_nothing

TEXT = """\
# a file of its owner's own hand
name: rig   # the old one
list:
- 1
- {a: 2, b: [3, 4]}   # in flow
nested:
    block:
      - x: 1
        y: [1.0,
            2.0]
      - x: 2
    # a comment at the end
empty: {}
last: |
  some
  text
"""


def nodes(node: Any) -> Iterator[tuple[Any, ...]]:
    """Return tag and place of a node and of all below it."""
    yield node.tag, node.start_mark.index, node.start_mark.line, node.end_mark.index, node.end_mark.line
    for child in node.value if isinstance(node, yaml.CollectionNode) else ():
        for part in child if isinstance(child, tuple) else (child,):
            yield from nodes(part)


@pytest.mark.parametrize("text", [TEXT, "a: 010\nb: 2e-5\nc: 1:30\nd: é µ\ne: 'quoted'\nf: &x [1, {g: .5}]\nh: *x\n"])
def test_both_loaders_give_the_same_content_and_positions(text: str) -> None:
    fast, slow = FastLoader(text), StrictLoader(text)
    found, expected = fast.get_single_node(), slow.get_single_node()
    assert list(nodes(found)) == list(nodes(expected))
    assert fast.construct_document(found) == slow.construct_document(expected)


def test_key_paths_are_parsed() -> None:
    assert parse_key_path("sensors[0].probes[1].tip") == ("sensors", 0, "probes", 1, "tip")
    assert parse_key_path("maps.fitted[2][3]") == ("maps", "fitted", 2, 3)
    for wrong in ("", "a..b", "a[x]", "a[1", ".a", "a.[1]"):
        assert refusal(CalibrationError, parse_key_path, wrong).what == f"malformed key path '{wrong}'"


@pytest.mark.parametrize(
    ("key", "new", "old_line", "new_line"),
    [
        ("name", "new", "name: rig   # the old one", "name: new   # the old one"),
        ("list[0]", 7.5, "- 1", "- 7.5"),
        ("list[1].b", [5.0, 6e-07], "- {a: 2, b: [3, 4]}   # in flow", "- {a: 2, b: [5.0, 6.0e-07]}   # in flow"),
        ("list[1].c", {"deep": 1}, "- {a: 2, b: [3, 4]}   # in flow", "- {a: 2, b: [3, 4], c: {deep: 1}}   # in flow"),
        ("nested.block[1].x", {"value": 1.0, "unit": "m"}, "      - x: 2", "      - x: {value: 1.0, unit: m}"),
        ("empty.first", 1, "empty: {}", "empty: {first: 1}"),
    ],
)
def test_only_the_edited_entry_changes(key: str, new: Any, old_line: str, new_line: str) -> None:
    expected = TEXT.replace(old_line + "\n", new_line + "\n")
    assert edit_document(TEXT, "rig", {key: new}).split("\n") == expected.split("\n")


def test_blocks_are_replaced_and_added() -> None:
    changed = edit_document(
        TEXT, "rig", {"nested.block[0]": {"x": 3}, "nested.more": {"k": [1, 2]}, "last": "short", "new": [{"a": 1}]}
    )
    assert yaml.safe_load(changed) == {
        "name": "rig",
        "list": [1, {"a": 2, "b": [3, 4]}],
        "nested": {"block": [{"x": 3}, {"x": 2}], "more": {"k": [1, 2]}},
        "empty": {},
        "last": "short",
        "new": [{"a": 1}],
    }
    for comment in ("# a file of its owner's own hand", "# the old one", "# in flow", "# a comment at the end"):
        assert comment in changed


def test_only_the_edited_entry_of_a_random_file_changes(rng: np.random.Generator) -> None:
    def made(depth: int) -> Any:
        kind = rng.integers(3) if depth else 2
        if kind == 0:
            return {f"k{i}": made(depth - 1) for i in range(rng.integers(1, 4))}
        if kind == 1:
            return [made(depth - 1) for _ in range(rng.integers(1, 4))]
        return float(rng.normal())

    def paths(content: Any, key: str) -> list[str]:
        if isinstance(content, dict):
            return [key] + [p for name, part in content.items() for p in paths(part, f"{key}.{name}".lstrip("."))]
        if isinstance(content, list):
            return [key] + [p for i, part in enumerate(content) for p in paths(part, f"{key}[{i}]")]
        return [key]

    for trial in range(60):
        content = {"root": made(4), "other": made(2)}
        text = yaml.safe_dump(content, default_flow_style=[True, None, False][trial % 3], width=40)
        for key in rng.permutation(paths(content, "")[1:])[:4]:
            new = [{"v": [1.0, 2.0]}, "text: #", -1e-9][rng.integers(3)]
            part: Any = content
            expected = yaml.safe_load(yaml.safe_dump(content))
            *way, leaf = parse_key_path(str(key))
            part = expected
            for step in way:
                part = part[step]
            part[leaf] = new
            assert yaml.safe_load(edit_document(text, "random", {str(key): new})) == expected


def test_entries_shared_by_an_alias_are_refused() -> None:
    text = "a: &same {value: 1.0, unit: m}\nb: *same\nc: {<<: *same, value: 2.0}\n"
    for key in ("a", "b.value", "a.value"):
        error = refusal(CalibrationError, edit_document, text, "rig", {key: 3.0})
        assert (error.where, error.what) == ("rig", f"{key} cannot be changed alone")


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("nested.blok[0].x", "rig, line 6, key nested: key 'blok' is missing."),
        ("list[5]", "rig, line 3, key list: entry 5 is missing."),
        ("name.first", "rig, line 2, key name: entry first is missing."),
    ],
)
def test_a_key_path_without_entry_is_named(key: str, sentence: str) -> None:
    assert str(refusal(CalibrationError, edit_document, TEXT, "rig", {key: 1})) == sentence


@pytest.mark.parametrize("text", ["3e-06", "1e5", "010", "1:30", "yes", "1.5", ".5", "null"])
def test_text_that_looks_like_a_number_stays_text(text: str) -> None:
    changed = edit_document("options: {wobble: none}\n", "bench", {"options.wobble": text})
    assert parse_yaml(changed, "bench")[1] == {"options": {"wobble": text}}


# Saving.


def test_a_new_file_is_written_and_an_existing_one_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    refuse_existing(path, force=False)
    assert save_calibration(path, "one\n") is None
    assert path.read_text(encoding="utf-8") == "one\n"
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    for refuse in (lambda: save_calibration(path, "two\n"), lambda: refuse_existing(path, force=False)):
        sentence = f"calibration file {path}: exists already; expected another name, or --force."
        assert str(refusal(CalibrationError, refuse)) == sentence
    assert path.read_text(encoding="utf-8") == "one\n"
    assert [file.name for file in tmp_path.iterdir()] == ["rig.yaml"]


def test_a_replaced_file_is_kept_under_the_next_free_number(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    save_calibration(path, "one\n")
    path.chmod(0o640)
    refuse_existing(path, force=True)
    assert save_calibration(path, "two\n", force=True) == tmp_path / "rig.yaml.1"
    assert save_calibration(path, "three\n", force=True) == tmp_path / "rig.yaml.2"
    assert {file.name: file.read_text(encoding="utf-8") for file in tmp_path.iterdir()} == {
        "rig.yaml": "three\n",
        "rig.yaml.1": "one\n",
        "rig.yaml.2": "two\n",
    }
    assert path.stat().st_mode & 0o777 == 0o640


def test_of_several_files_all_are_replaced_or_none(tmp_path: Path) -> None:
    old, other, new = (tmp_path / name for name in ("old.yaml", "other.yaml", "new.yaml"))
    for path in (old, other):
        save_calibration(path, "one\n")
    before = contents_of(tmp_path)
    assert refusal(CalibrationError, save_files, {new: "two\n", old: "two\n"}).where == f"calibration file {old}"
    assert contents_of(tmp_path) == before
    with full_disk_changes_nothing(tmp_path, 1000):
        refusal(CalibrationError, save_files, {old: "two\n", other: 2000 * "x"}, force=True)
    assert save_files({old: "two\n", new: "two\n", other: "two\n"}, force=True) == [
        tmp_path / "old.yaml.1",
        tmp_path / "other.yaml.1",
    ]
    assert contents_of(tmp_path).keys() == {"old.yaml", "old.yaml.1", "other.yaml", "other.yaml.1", "new.yaml"}


@pytest.mark.parametrize("name", ["hardlink_to", "replace"])
def test_a_replacement_that_fails_restores_the_files_before_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = getattr(Path, name)

    def without_space(path: Path, other: Path) -> object:
        if (other.name if name == "hardlink_to" else path.name).lstrip(".").startswith("other.yaml"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(path, other)

    paths = [tmp_path / name for name in ("old.yaml", "other.yaml")]
    for path in paths:
        save_calibration(path, "one\n")
    before = contents_of(tmp_path)
    monkeypatch.setattr(Path, name, without_space)
    error = refusal(CalibrationError, save_files, dict.fromkeys(paths, "two\n"), force=True)
    assert error.what == "cannot be written: No space left on device"
    assert contents_of(tmp_path) == before


def test_the_target_of_a_symbolic_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "rig.yaml", tmp_path / "rig.yaml"
    save_calibration(real, "one\n")
    link.symlink_to(real)
    save_calibration(link, "two\n", force=True)
    assert link.is_symlink()
    assert real.read_text(encoding="utf-8") == "two\n"


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none" / "rig.yaml"
    error = refusal(CalibrationError, save_calibration, path, "one\n")
    assert error.what == "cannot be written: No such file or directory"
    assert refusal(CalibrationError, refuse_existing, path, force=True).what == "its folder does not exist"

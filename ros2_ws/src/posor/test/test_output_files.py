# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Output files: all or none, and what is written without being replaced."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from posor.errors import OutputError
from posor.output_files import prepared_files, write_files
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.full_disk import contents_of, full_disk_changes_nothing

NOBODY = 65534


def former(path: Path, mode: int = 0o644) -> Path:
    """Write a file that an earlier run might have left."""
    path.write_text("former", encoding="utf-8")
    path.chmod(mode)
    return path


@contextmanager
def without_privileges() -> Iterator[None]:
    """Run a block as a user whom the system refuses something."""
    user = os.geteuid()
    os.seteuid(user or NOBODY)
    try:
        yield
    finally:
        os.seteuid(user)


def test_files_have_their_contents_and_the_permissions_of_a_former_or_a_new_file(tmp_path: Path) -> None:
    old, new, empty = former(tmp_path / "old", 0o640), tmp_path / f"{'µ' * 120}.csv", tmp_path / "empty"
    empty.touch()
    write_files({old: "1 µm\r\n", new: b"\xff"})
    assert contents_of(tmp_path) == {"old": "1 µm\r\n".encode(), new.name: b"\xff", "empty": b""}
    assert (old.stat().st_mode, new.stat().st_mode) == (0o100640, empty.stat().st_mode)


def test_a_full_disk_keeps_all_former_files(tmp_path: Path) -> None:
    first, second = former(tmp_path / "first"), former(tmp_path / "second")
    with full_disk_changes_nothing(tmp_path, 1000):
        error = refusal(OutputError, write_files, {first: "new", second: 2000 * "x", tmp_path / "third": "new"})
    assert str(error) == f"{second}: cannot be written, File too large."


def test_files_appear_only_when_the_block_has_ended(tmp_path: Path) -> None:
    path = former(tmp_path / "rig.yaml")
    with pytest.raises(KeyError), prepared_files({path: "new"}):
        raise KeyError
    assert contents_of(tmp_path) == {"rig.yaml": b"former"}
    with prepared_files({path: "new"}):
        assert path.read_text(encoding="utf-8") == "former"
    assert contents_of(tmp_path) == {"rig.yaml": b"new"}


def test_a_folder_is_refused_and_the_others_stay(tmp_path: Path) -> None:
    first, folder = former(tmp_path / "first"), tmp_path / "folder"
    folder.mkdir()
    sentence = f"{folder}: cannot be written, Is a directory."
    assert str(refusal(OutputError, write_files, {first: "new", folder: "new"})) == sentence
    assert first.read_text(encoding="utf-8") == "former"
    assert sorted(tmp_path.iterdir()) == [first, folder]


def test_a_file_without_write_permission_is_refused() -> None:
    with TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        path = former(Path(name) / "rig.yaml", 0o444)
        with without_privileges():
            error = refusal(OutputError, write_files, {path: "new"})
        assert str(error) == f"{path}: cannot be written, Permission denied."
        assert contents_of(Path(name)) == {"rig.yaml": b"former"}


def test_the_target_of_a_symbolic_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    old, new = former(tmp_path / "real" / "old"), tmp_path / "real" / "new"
    links = [tmp_path / "to_old", tmp_path / "to_new"]
    for link, target in zip(links, (old, new), strict=True):
        link.symlink_to(target)
    write_files(dict.fromkeys(links, "text"))
    assert all(link.is_symlink() for link in links)
    assert contents_of(tmp_path / "real") == {"old": b"text", "new": b"text"}


def test_a_pipe_is_written_and_not_replaced(tmp_path: Path) -> None:
    named, beside = tmp_path / "pipe", tmp_path / "beside"
    os.mkfifo(named)
    output, end = os.pipe()
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(named.read_bytes)
        write_files({named: "one", beside: "two", Path(f"/dev/fd/{end}"): "three"})
    os.close(end)
    assert read.result() == b"one"
    assert os.read(output, 10) == b"three"
    os.close(output)
    assert named.is_fifo()
    assert sorted(tmp_path.iterdir()) == [beside, named]


def test_standard_output_in_a_file_is_written_and_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "log"
    code = (
        "import sys; from pathlib import Path; from posor.output_files import write_files; print('begin', flush=True); "
    )
    code += "write_files({Path('/dev/stdout'): 'middle\\n'}); print('end')"
    with path.open("ab") as file:
        subprocess.run([sys.executable, "-c", code], stdout=file, check=True)
    assert path.read_text(encoding="utf-8").splitlines()[-1] == "end"
    assert "middle" in path.read_text(encoding="utf-8")


def test_a_link_to_itself_is_replaced(tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    write_files({loop: "text"})
    assert contents_of(tmp_path) == {"loop": b"text"}

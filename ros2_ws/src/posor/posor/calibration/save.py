# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write files atomically and keep the files that they replace."""

from __future__ import annotations

import os
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import CalibrationError
from posor.output_files import unfinished_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


def save_calibration(path: Path, text: str, *, force: bool = False) -> Path | None:
    """Write a calibration file.

    The write is atomic. A replaced file is kept beside the new one under its name with ``.1``, ``.2`` or the next free
    number.

    ``force``: whether an existing file may be replaced. Returns the path of the replaced file; None if there was none.
    Raises CalibrationError: the file exists and ``force`` is false, or it cannot be written.
    """
    return next(iter(save_files({path: text}, force=force)), None)


def save_files(texts: Mapping[Path, str], *, force: bool = False) -> list[Path]:
    """Write files as ``save_calibration`` does, all or none; return the paths under which replaced files are kept.

    Raises CalibrationError: a file exists and ``force`` is false, or a file cannot be written.
    """
    kept: list[Path] = []
    with ExitStack() as unfinished, ExitStack() as undo:
        written: dict[Path, tuple[Path, Path]] = {}
        for path, text in texts.items():
            with _saving(path):
                target = Path(os.path.realpath(path))  # the target of a symbolic link is replaced, not the link
                written[path] = target, unfinished.enter_context(unfinished_file(target, text.encode("utf-8")))
        for path, (target, new) in written.items():
            with _saving(path):
                if force and target.exists():
                    kept.append(_back_up(target))
                    undo.callback(_discard, kept[-1])
                    new.replace(target)
                    undo.callback(kept[-1].replace, target)
                else:
                    target.hardlink_to(new)  # unlike a rename it fails if the file has been created meanwhile
                    undo.callback(_discard, target)
        undo.pop_all()
    return kept


def refuse_existing(path: Path, *, force: bool) -> None:
    """Check before hours of work what ``save_calibration`` would refuse after them.

    Raises CalibrationError: the file exists and ``force`` is false, or the folder is missing.
    """
    where = f"calibration file {path}"
    if path.exists() and not force:
        raise CalibrationError("exists already", where=where, expected="another name, or --force")
    if not path.resolve().parent.is_dir():
        raise CalibrationError("its folder does not exist", where=where, expected="an existing folder")


@contextmanager
def _saving(path: Path) -> Iterator[None]:
    """Turn errors of the operating system into a CalibrationError that names the file."""
    where = f"calibration file {path}"
    try:
        yield
    except FileExistsError as error:
        raise CalibrationError("exists already", where=where, expected="another name, or --force") from error
    except OSError as error:
        raise CalibrationError(f"cannot be written: {error.strerror}", where=where) from error


def _discard(path: Path) -> None:
    with suppress(OSError):  # it would hide the first error
        path.unlink(missing_ok=True)


def _back_up(target: Path) -> Path:
    """Link the present file under the next free number."""
    for number in count(1):
        beside = target.with_name(f"{target.name}.{number}")
        with suppress(FileExistsError):
            beside.hardlink_to(target)
            return beside
    raise AssertionError

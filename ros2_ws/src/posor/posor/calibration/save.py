# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write a file atomically and keep the file that it replaces."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from itertools import count
from pathlib import Path

from posor.errors import CalibrationError


def save_calibration(path: Path, text: str, *, force: bool = False) -> Path | None:
    """Write a calibration file.

    The write is atomic. A replaced file is kept beside the new one under its name with ``.1``, ``.2`` or the next free
    number.

    ``force``: whether an existing file may be replaced. Returns the path of the replaced file; None if there was none.
    Raises CalibrationError: the file exists and ``force`` is false, or it cannot be written.
    """
    where = f"calibration file {path}"
    # The target of a symbolic link is replaced, not the link.
    target = path.resolve()
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=target.parent, prefix=f".{target.name}.", delete=False
        ) as file:
            written = Path(file.name)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            return _publish_file(written, target, force=force)
        finally:
            with suppress(FileNotFoundError):
                written.unlink()
    except FileExistsError as error:
        raise CalibrationError("exists already", where=where, expected="another name, or --force") from error
    except OSError as error:
        raise CalibrationError(f"cannot be written: {error.strerror}", where=where) from error


def refuse_existing(path: Path, *, force: bool) -> None:
    """Check before hours of work what ``save_calibration`` would refuse after them.

    Raises CalibrationError: the file exists and ``force`` is false, or the folder is missing.
    """
    where = f"calibration file {path}"
    if path.exists() and not force:
        raise CalibrationError("exists already", where=where, expected="another name, or --force")
    if not path.resolve().parent.is_dir():
        raise CalibrationError("its folder does not exist", where=where, expected="an existing folder")


def _publish_file(written: Path, target: Path, *, force: bool) -> Path | None:
    """Rename a complete file to its final name."""
    if force and target.exists():
        written.chmod(target.stat().st_mode & 0o777)
        backup = _back_up(target)
        written.replace(target)
        return backup
    mask = os.umask(0)
    os.umask(mask)
    written.chmod(0o666 & ~mask)
    target.hardlink_to(written)  # unlike a rename it fails if the file has been created meanwhile
    return None


def _back_up(target: Path) -> Path:
    """Link the present file under the next free number."""
    for number in count(1):
        beside = target.with_name(f"{target.name}.{number}")
        with suppress(FileExistsError):
            beside.hardlink_to(target)
            return beside
    raise AssertionError

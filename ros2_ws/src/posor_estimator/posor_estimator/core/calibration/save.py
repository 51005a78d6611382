"""Write a file whole or not at all, and never lose the one that was there."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from itertools import count
from pathlib import Path

from posor_estimator.errors import CalibrationError


def save(path: Path, text: str, *, force: bool = False) -> Path | None:
    """Write a calibration file.

    The text appears under the path at one instant, whole. A file that is replaced stays beside it, under its name with
    ``.1``, ``.2`` or the next number that is free.

    Args:
        path: Where to.
        text: What.
        force: Whether a file that is there may be replaced.

    Returns:
        Where the replaced file is now; None if there was none.

    Raises:
        CalibrationError: There is such a file and ``force`` was not given, or it cannot be written.

    """
    where = f"calibration file {path}"
    # Through a symbolic link: the file it leads to is what is replaced, not the link.
    goal = path.resolve()
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", dir=goal.parent, prefix=f".{goal.name}.", delete=False
        ) as file:
            written = Path(file.name)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            return _move(written, goal, force=force)
        finally:
            with suppress(FileNotFoundError):
                written.unlink()
    except FileExistsError as error:
        raise CalibrationError("is there already", where=where, expected="another name, or --force") from error
    except OSError as error:
        raise CalibrationError(f"cannot be written: {error.strerror}", where=where) from error


def refuse_existing(path: Path, *, force: bool) -> None:
    """Refuse early what ``save`` would refuse after hours of work.

    Raises:
        CalibrationError: There is such a file and ``force`` was not given, or no such folder.

    """
    where = f"calibration file {path}"
    if path.exists() and not force:
        raise CalibrationError("is there already", where=where, expected="another name, or --force")
    if not path.resolve().parent.is_dir():
        raise CalibrationError("its folder is not there", where=where, expected="a folder that exists")


def _move(written: Path, goal: Path, *, force: bool) -> Path | None:
    """Give a complete file its name."""
    if force and goal.exists():
        written.chmod(goal.stat().st_mode & 0o777)
        kept = _kept(goal)
        written.replace(goal)
        return kept
    mask = os.umask(0)
    os.umask(mask)
    written.chmod(0o666 & ~mask)
    goal.hardlink_to(written)  # other than a rename, it fails where a file has come in between
    return None


def _kept(goal: Path) -> Path:
    """Give the present file one more name."""
    for number in count(1):
        beside = goal.with_name(f"{goal.name}.{number}")
        with suppress(FileExistsError):
            beside.hardlink_to(goal)
            return beside
    raise AssertionError

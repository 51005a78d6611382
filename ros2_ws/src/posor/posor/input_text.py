# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Text files that a user names: read whole, without waiting for anybody."""

from __future__ import annotations

import errno
import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES = 1 << 25  # largest size; a calibration file has some 100 kB


def read_input_text(path: Path) -> str:
    """Return the text of a file.

    Raises OSError: the file cannot be read, is larger than MAX_BYTES, or is a pipe or device, on which a reader may
    wait for ever. ``strerror`` names the cause. Raises UnicodeDecodeError: it is not UTF-8 text.
    """
    check_input_file(path, MAX_BYTES)
    return path.read_text(encoding="utf-8")


def read_input_bytes(path: Path, most: int) -> bytes:
    """Return the bytes of a file of at most ``most`` bytes. Raises OSError as ``read_input_text``."""
    check_input_file(path, most)
    return path.read_bytes()


def check_input_file(path: Path, most: int) -> None:
    """Raise OSError if a path is no file of at most ``most`` bytes; a folder is refused when it is opened."""
    if "\0" in str(path):  # "\0" in a double-quoted text of YAML, such as a path of Windows
        raise OSError(errno.EINVAL, "its name contains a null character", str(path))
    status = path.stat()
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):  # open() refuses a folder
        raise OSError(errno.EINVAL, "a pipe or device, not a file", str(path))
    if status.st_size > most:
        raise OSError(errno.EFBIG, f"{status.st_size >> 20} MiB, more than {most >> 20} MiB", str(path))

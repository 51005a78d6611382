# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A stand-in for a full disk: a limit of the size of the files of this process."""

from __future__ import annotations

import resource
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Limit the files that this process writes in a ``with`` block to a size [bytes]."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@contextmanager
def full_disk_changes_nothing(folder: Path, size: int) -> Iterator[None]:
    """Limit files as ``file_size_limit`` does. Raises AssertionError: the block has changed the files of a folder."""
    former = contents_of(folder)
    with file_size_limit(size):
        yield
    if contents_of(folder) != former:
        raise AssertionError(f"the files of {folder} have changed")


def contents_of(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files in a folder by their paths in it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

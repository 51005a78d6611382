# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Output files: whole under their names or not there, and errors that name them."""

from __future__ import annotations

import os
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from posor.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path


def write_files(contents: Mapping[Path, str | bytes]) -> None:
    """Write files, all or none; see ``prepared_files``. Raises OutputError: one cannot be written."""
    with prepared_files(contents):
        pass


@contextmanager
def prepared_files(contents: Mapping[Path, str | bytes]) -> Iterator[None]:
    """Run a block while files are complete under hidden names; then they get their names, unless it raises an error.

    The target of a symbolic link is replaced, not the link; what is no regular file, such as a pipe, is written and not
    replaced. Raises OutputError: a file cannot be written; then none is replaced, unless the system refuses to rename a
    later one.
    """
    with ExitStack() as stack:
        streams: dict[Path, bytes] = {}
        files: dict[Path, tuple[Path, Path]] = {}
        for path, content in contents.items():
            data = content.encode("utf-8") if isinstance(content, str) else content
            with writing(path):
                if path.exists() and not (path.is_file() or path.is_dir()):
                    streams[path] = data
                    continue
                target = path.resolve()
                if target.exists():
                    target.open("ab").close()  # refuses a folder, and a file without write permission
                files[path] = target, stack.enter_context(unfinished_file(target, data))
        yield
        for path, data in streams.items():
            with writing(path):
                path.write_bytes(data)
        for path, (target, unfinished) in files.items():
            with writing(path):
                unfinished.replace(target)


@contextmanager
def unfinished_file(target: Path, content: bytes) -> Iterator[Path]:
    """Yield a hidden file with a content, on the disk, to be renamed to its target; remove it if it is still there.

    It has the permissions of the target, if there is one, else those of a new file. Raises OSError: it cannot be
    written.
    """
    unfinished = target.with_name(f".{target.name[:50]}.{os.urandom(8).hex()}")  # a long name may be at its limit
    try:
        with unfinished.open("xb") as file:
            if target.exists():
                unfinished.chmod(target.stat().st_mode & 0o777)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        yield unfinished
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def writing(output: Path) -> Iterator[None]:
    """Turn errors of the operating system into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot be written, {error.strerror}", where=str(output)) from error

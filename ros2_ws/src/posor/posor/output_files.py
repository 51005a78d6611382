# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write output files atomically; errors name the file."""

from __future__ import annotations

import os
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

STREAM_FOLDERS = (Path("/dev"), Path("/dev/fd"), Path("/proc/self/fd"))
"""Their files are written in place also where they lead to a file, such as ``/dev/stdout`` of a redirected program."""


def write_files(contents: Mapping[Path, str | bytes]) -> None:
    """Write files; none is replaced before all are complete. Raises OutputError: a file cannot be written."""
    with prepared_files(contents):
        pass


@contextmanager
def prepared_files(contents: Mapping[Path, str | bytes]) -> Iterator[None]:
    """Write files under hidden names, run the block, then rename the files; no file is replaced if the block raises.

    The target of a symbolic link is replaced, not the link. Pipes, devices and ``/dev/stdout`` are written, not
    replaced. Raises OutputError: a file cannot be written; then none is replaced, unless the system refuses to rename a
    later one.
    """
    with ExitStack() as stack:
        streams: dict[Path, bytes] = {}
        files: dict[Path, tuple[Path, Path]] = {}
        for path, content in contents.items():
            data = content.encode("utf-8") if isinstance(content, str) else content
            with writing(path):
                if path.parent in STREAM_FOLDERS or (path.exists() and not (path.is_file() or path.is_dir())):
                    streams[path] = data
                    continue
                target = Path(os.path.realpath(path)) if path.is_symlink() else path  # 'missing/../file' is no file
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
    """Yield a complete hidden file beside its target, flushed to disk; remove it unless the caller has renamed it.

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
        with suppress(OSError):  # it would hide the first error
            unfinished.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents. Raises OutputError: it cannot be created."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def writing(output: Path) -> Iterator[None]:
    """Turn errors of the operating system into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot be written, {error.strerror}", where=str(output)) from error

"""Where results may go: what is there is replaced only where a mark of this program says that it consists of results.

The mark is a file among the results that lists the others with their sizes, written when they are whole. So neither
recordings nor results to which something was added are taken for results, whatever they are called.
"""

from __future__ import annotations

import json
from contextlib import contextmanager
from typing import TYPE_CHECKING

from posor_estimator.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

MARK = ".reprocess.json"
"""Name of the mark; readers of tables and of bags leave out what begins with a dot."""


def mark(folder: Path) -> None:
    """Mark all files of a folder as results."""
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    (folder / MARK).write_text(json.dumps({"results": sizes}, indent=1) + "\n", encoding="utf-8")


def refuse(output: Path, *, force: bool) -> None:
    """Refuse a place for results.

    Raises:
        OutputError: There is something that is no result; or there are results, and they are not to be replaced.

    """
    with writing(output):
        if not output.exists() and not output.is_symlink():
            return
        if not output.is_dir() or output.is_symlink():
            raise OutputError("is no folder of results", where=str(output), expected="another name")
        sizes = _marked(output)
        for entry in sorted(output.iterdir()):
            if entry.is_symlink() or not entry.is_file() or entry.stat().st_size != sizes.get(entry.name):
                raise OutputError(
                    f"holds {entry.name}, which is not marked as a result", where=str(output), expected="another name"
                )
    if not force:
        raise OutputError("exists already", where=str(output), expected="another name, or --force to replace it")


def refuse_among(output: Path, bags: Sequence[Path]) -> None:
    """Refuse a place for results that would touch what is read.

    Raises:
        OutputError: It is, holds, or lies in one of the bags.

    """
    place = output.resolve()
    for bag in bags:
        read = _folder(bag)
        if place == read:
            how = "is"
        elif place in read.parents:
            how = "holds"
        elif read in place.parents:
            how = "lies in"
        else:
            continue
        raise OutputError(f"{how} bag {bag}, which is to be read", where=str(output), expected="a place outside of it")


@contextmanager
def writing(output: Path) -> Iterator[None]:
    """Say of what the system refuses that the output cannot be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot be written, {error.strerror}", where=str(output)) from error


def _folder(bag: Path) -> Path:
    """Return the folder of a bag, also where its file is named; the file where it belongs to no folder."""
    bag = bag.resolve()
    return bag.parent if bag.is_file() and (bag.parent / "metadata.yaml").exists() else bag


def _marked(folder: Path) -> dict[str, int]:
    """Return the sizes of the files that are marked as results, and of the mark itself."""
    path = folder / MARK
    try:
        marked = dict(json.loads(path.read_text(encoding="utf-8"))["results"])
        return marked | {MARK: path.stat().st_size}
    except (OSError, ValueError, KeyError, TypeError):
        return {}

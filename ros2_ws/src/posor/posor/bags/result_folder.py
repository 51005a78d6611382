# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The folder of results: it appears under its name when it is complete, and replaces nothing but results.

A mark, a file among the results, lists the other files with their sizes. So neither recordings nor results to which
something was added are taken for results, whatever they are called. A program that leaves its outputs in a folder of
the user (``prepare_outputs``) lists them without sizes, and replaces none that is not listed.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import OutputError
from posor.output_files import writing

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

MARK = ".results.json"  # name of the mark; readers of tables and bags ignore names that begin with a dot
UNFINISHED = ".making-"  # prefix of a folder with unfinished results; the name of the run follows
NEW, FORMER = "new", "former"  # folders in it with the new results, and with the results that they replace


@contextmanager
def new_result_folder(output: Path, run: str, *, force: bool) -> Iterator[Path]:
    """Yield a folder that does not exist yet and that replaces ``output`` if the block ends without an error.

    ``output``: the place of the results; ``run``: identifies the run; see ``clear_unfinished``; ``force``: whether
    existing results may be replaced. Raises OutputError: the place holds something that may not be replaced, or cannot
    be written.
    """
    check_replaceable(output, force=force)
    with ExitStack() as stack:
        with writing(output):
            output.parent.mkdir(parents=True, exist_ok=True)
            unfinished = Path(tempfile.mkdtemp(dir=output.parent, prefix=f"{UNFINISHED}{run}-"))
            stack.callback(_discard, unfinished)
            for folder in (NEW, FORMER):
                (unfinished / folder).mkdir()
        new = unfinished / NEW / output.name
        yield new
        check_replaceable(output, force=force)
        with writing(output):
            _write_mark(new, {path.name: path.stat().st_size for path in sorted(new.iterdir())})
            if output.exists():
                output.rename(unfinished / FORMER / output.name)
            new.rename(output)


def clear_unfinished(folder: Path, run: str) -> None:
    """Remove what terminated processes of a run have left in a folder of results."""
    for unfinished in folder.glob(f"{UNFINISHED}{run}-*"):
        _discard(unfinished)


def check_replaceable(output: Path, *, force: bool) -> None:
    """Refuse a place for results that holds something else.

    Raises OutputError: the place holds something that is not a result; or results, and ``force`` is false.
    """
    with writing(output):
        if not output.exists() and not output.is_symlink():
            return
        if not output.is_dir() or output.is_symlink():
            raise OutputError("is no folder of results", where=str(output), expected="another name")
        sizes = _marked(output)
        for entry in sorted(output.iterdir()):
            is_mark = entry.name == MARK and sizes
            is_file = entry.is_file() and not entry.is_symlink()
            if not is_file or not (is_mark or entry.stat().st_size == sizes.get(entry.name)):
                raise _not_marked(entry)
    if not force:
        raise OutputError("exists already", where=str(output), expected="another name, or --force to replace it")


def name_of_bag(bag: Path) -> str:
    """Return the name of a bag for its results: of the folder, or of the file without its ending."""
    path = bag.resolve()
    return path.stem if path.is_file() else path.name


def prepare_outputs(folder: Path, names: Sequence[str]) -> None:
    """Create a folder, and remove the outputs of an earlier run from it; everything else stays.

    ``names``: files and folders that the caller will write there. Raises OutputError: the folder holds one of the names
    without a mark, or cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        marked = _marked(folder)
        present = [entry for entry in map(folder.joinpath, names) if entry.exists() or entry.is_symlink()]
        for entry in present:
            if entry.name not in marked:
                raise _not_marked(entry)
        for entry in present:
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()
        _write_mark(folder, dict.fromkeys(names) | marked)


def check_outside_of_bags(output: Path, bags: Sequence[Path]) -> None:
    """Refuse a place for results that would touch a bag to be read.

    Raises OutputError: the place is one of the bags, holds one, or lies in one.
    """
    place = output.resolve()
    for bag in bags:
        folder = _bag_folder(bag)
        if place == folder:
            how = "is"
        elif place in folder.parents:
            how = "holds"
        elif folder in place.parents:
            how = "lies in"
        else:
            continue
        raise OutputError(f"{how} bag {bag}, which is to be read", where=str(output), expected="a place outside of it")


def _discard(unfinished: Path) -> None:
    """Remove an unfinished folder; former results go back unless new ones have taken their place."""
    with suppress(OSError):
        for former in (unfinished / FORMER).iterdir():
            if not (unfinished.parent / former.name).exists():
                former.rename(unfinished.parent / former.name)
        shutil.rmtree(unfinished, ignore_errors=True)


def _not_marked(entry: Path) -> OutputError:
    what = f"holds {entry.name}, which is not marked as a result"
    return OutputError(what, where=str(entry.parent), expected="another name")


def _write_mark(folder: Path, sizes: Mapping[str, int | None]) -> None:
    """Mark files of a folder as results; size None: the entry may change."""
    (folder / MARK).write_text(json.dumps({"results": sizes}, indent=1) + "\n", encoding="utf-8")


def _marked(folder: Path) -> dict[str, int | None]:
    """Return the sizes of the entries that are marked as results."""
    try:
        return dict(json.loads((folder / MARK).read_text(encoding="utf-8"))["results"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _bag_folder(bag: Path) -> Path:
    """Return the folder of a bag, also for its file; the file itself if it belongs to no folder."""
    bag = bag.resolve()
    return bag.parent if bag.is_file() and (bag.parent / "metadata.yaml").exists() else bag

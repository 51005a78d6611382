"""The folder of results: it appears under its name when it is complete, and replaces nothing but results.

A mark, a file among the results, lists the other files with their sizes. So neither recordings nor results to which
something was added are taken for results, whatever they are called.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from posor_estimator.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MARK = ".reprocess.json"
"""Name of the mark; readers of tables and bags ignore names that begin with a dot."""
UNFINISHED = ".making-"
"""Prefix of a folder with unfinished results; the name of the run follows."""
NEW, FORMER = "new", "former"
"""Folders in it with the new results, and with the results that they replace."""


@contextmanager
def new_result_folder(output: Path, run: str, *, force: bool) -> Iterator[Path]:
    """Yield a folder that does not exist yet and that replaces ``output`` if the block ends without an error.

    Args:
        output: The place of the results.
        run: Identifies the run; see ``clear_unfinished``.
        force: Whether existing results may be replaced.

    Raises:
        OutputError: The place holds something that may not be replaced, or cannot be written.

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
            _write_mark(new)
            if output.exists():
                output.rename(unfinished / FORMER / output.name)
            new.rename(output)


def clear_unfinished(folder: Path, run: str) -> None:
    """Remove what terminated processes of a run have left in a folder of results."""
    for unfinished in folder.glob(f"{UNFINISHED}{run}-*"):
        _discard(unfinished)


def check_replaceable(output: Path, *, force: bool) -> None:
    """Refuse a place for results that holds something else.

    Raises:
        OutputError: The place holds something that is not a result; or results, and ``force`` is false.

    """
    with writing(output):
        if not output.exists() and not output.is_symlink():
            return
        if not output.is_dir() or output.is_symlink():
            raise OutputError("is no folder of results", where=str(output), expected="another name")
        sizes = _marked_sizes(output)
        for entry in sorted(output.iterdir()):
            if entry.is_symlink() or not entry.is_file() or entry.stat().st_size != sizes.get(entry.name):
                raise OutputError(
                    f"holds {entry.name}, which is not marked as a result", where=str(output), expected="another name"
                )
    if not force:
        raise OutputError("exists already", where=str(output), expected="another name, or --force to replace it")


def check_outside_of_bags(output: Path, bags: Sequence[Path]) -> None:
    """Refuse a place for results that would touch a bag to be read.

    Raises:
        OutputError: The place is one of the bags, holds one, or lies in one.

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


@contextmanager
def writing(output: Path) -> Iterator[None]:
    """Turn errors of the operating system into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot be written, {error.strerror}", where=str(output)) from error


def _discard(unfinished: Path) -> None:
    """Remove an unfinished folder; former results go back unless new ones have taken their place."""
    with suppress(OSError):
        for former in (unfinished / FORMER).iterdir():
            if not (unfinished.parent / former.name).exists():
                former.rename(unfinished.parent / former.name)
        shutil.rmtree(unfinished, ignore_errors=True)


def _write_mark(folder: Path) -> None:
    """Mark all files of a folder as results."""
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    (folder / MARK).write_text(json.dumps({"results": sizes}, indent=1) + "\n", encoding="utf-8")


def _marked_sizes(folder: Path) -> dict[str, int]:
    """Return the sizes of the files that are marked as results, and of the mark."""
    path = folder / MARK
    try:
        marked = dict(json.loads(path.read_text(encoding="utf-8"))["results"])
        return marked | {MARK: path.stat().st_size}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _bag_folder(bag: Path) -> Path:
    """Return the folder of a bag, also for its file; the file itself if it belongs to no folder."""
    bag = bag.resolve()
    return bag.parent if bag.is_file() and (bag.parent / "metadata.yaml").exists() else bag

"""Where results go: a folder that appears under its name only once it is whole."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from posor_estimator.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from posor_estimator.reprocess.endpoint import Endpoints
    from posor_estimator.reprocess.transforms import Transforms

MADE = {".yaml", ".mcap", ".parquet", ".csv"}
"""Kinds of files that results consist of; a folder that holds anything else is not replaced."""
MAKING = ".making-"
"""How the name of a folder begins in which results are being made."""


class Output(Protocol):
    """Takes the results of a bag, block after block."""

    def write(self, transforms: Mapping[str, Transforms], endpoints: Endpoints | None) -> None:
        """Write what a block has given: of each joint the transforms, and endpoints where there is a chain."""

    def close(self) -> None:
        """Write what belongs at the end."""


class Told:
    """An output of which is told what the system refuses."""

    def __init__(self, place: Path, make: Callable[[], Output]) -> None:
        """Make an output; ``place`` is what to call it.

        Raises:
            OutputError: The system refuses; as ``write`` and ``close`` raise it too.

        """
        self._place = place
        with _writing(place):
            self._output = make()

    def write(self, transforms: Mapping[str, Transforms], endpoints: Endpoints | None) -> None:
        """Write what a block has given."""
        with _writing(self._place):
            self._output.write(transforms, endpoints)

    def close(self) -> None:
        """Write what belongs at the end."""
        with _writing(self._place):
            self._output.close()


def refuse(output: Path, *, force: bool) -> None:
    """Refuse a place for results.

    Raises:
        OutputError: There is something, and it may not be replaced; or it is nothing that this program has made.

    """
    if not output.exists() and not output.is_symlink():
        return
    if not force:
        raise OutputError("exists already", where=str(output), expected="another name, or --force to replace it")
    if not output.is_dir() or output.is_symlink():
        raise OutputError("is no folder of results", where=str(output), expected="another name")
    for entry in sorted(output.iterdir()):
        if not entry.is_file() or entry.suffix not in MADE:
            raise OutputError(f"holds {entry.name}, which is no result", where=str(output), expected="another name")


@contextmanager
def made(output: Path, *, force: bool) -> Iterator[Path]:
    """Yield a folder, not yet there, that takes the place of ``output`` once the block has ended well.

    Raises:
        OutputError: There is something already; or the system refuses.

    """
    refuse(output, force=force)
    with ExitStack() as stack:
        with _writing(output):
            output.parent.mkdir(parents=True, exist_ok=True)
            making = Path(tempfile.mkdtemp(dir=output.parent, prefix=f"{MAKING}{output.name}-"))
        stack.callback(shutil.rmtree, making, ignore_errors=True)
        yield making / output.name
        refuse(output, force=force)
        with _writing(output):
            _replace(output, making)


def _replace(output: Path, making: Path) -> None:
    """Put the new folder into its place; where that fails the former one is there again."""
    former = making / "former"
    if output.exists():
        output.rename(former)
    try:
        (making / output.name).rename(output)
    except OSError:
        if former.exists():
            former.rename(output)
        raise


@contextmanager
def _writing(output: Path) -> Iterator[None]:
    """Say of what the system refuses that the output cannot be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot be written, {error.strerror}", where=str(output)) from error


def clear_unfinished(output: Path) -> None:
    """Remove what a run that was killed has left of ``output``."""
    for left in output.parent.glob(f"{MAKING}{output.name}-*"):
        shutil.rmtree(left, ignore_errors=True)

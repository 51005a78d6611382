"""Where results go: a folder that appears under its name only once it is whole."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from posor_estimator.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=output.parent, prefix=f"{MAKING}{output.name}-") as making:
            folder = Path(making) / output.name
            yield folder
            refuse(output, force=force)
            if output.exists():
                output.rename(Path(making) / "former")
            folder.rename(output)
    except OSError as error:
        raise OutputError(f"cannot be written, {error.strerror}", where=str(output)) from error


def clear_unfinished(output: Path) -> None:
    """Remove what a run that was killed has left of ``output``."""
    for left in output.parent.glob(f"{MAKING}{output.name}-*"):
        shutil.rmtree(left, ignore_errors=True)

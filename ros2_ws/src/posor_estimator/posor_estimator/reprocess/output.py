"""Where results go: a folder that appears under its name only once it is whole."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from posor_estimator.reprocess.place import mark, refuse, writing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from posor_estimator.reprocess.endpoint import Endpoints
    from posor_estimator.reprocess.transforms import Transforms

MAKING = ".making-"
"""How the name of a folder begins in which results are being made; the name of the run follows."""
NEW, FORMER = "new", "former"
"""Where in it the results are, and those that they replace."""


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
        with writing(place):
            self._output = make()

    def write(self, transforms: Mapping[str, Transforms], endpoints: Endpoints | None) -> None:
        """Write what a block has given."""
        with writing(self._place):
            self._output.write(transforms, endpoints)

    def close(self) -> None:
        """Write what belongs at the end."""
        with writing(self._place):
            self._output.close()


@contextmanager
def made(output: Path, run: str, *, force: bool) -> Iterator[Path]:
    """Yield a folder, not yet there, that takes the place of ``output`` once the block has ended well.

    Args:
        output: The place.
        run: To which the results belong; see ``clear_unfinished``.
        force: Whether results that are there may be replaced.

    Raises:
        OutputError: There is something that may not be replaced; or the system refuses.

    """
    refuse(output, force=force)
    with ExitStack() as stack:
        with writing(output):
            output.parent.mkdir(parents=True, exist_ok=True)
            making = Path(tempfile.mkdtemp(dir=output.parent, prefix=f"{MAKING}{run}-"))
            stack.callback(_discard, making)
            for folder in (NEW, FORMER):
                (making / folder).mkdir()
        yield making / NEW / output.name
        refuse(output, force=force)
        with writing(output):
            mark(making / NEW / output.name)
            if output.exists():
                output.rename(making / FORMER / output.name)
            (making / NEW / output.name).rename(output)


def clear_unfinished(folder: Path, run: str) -> None:
    """Remove what processes of a run that were ended have left in a folder of results."""
    for making in folder.glob(f"{MAKING}{run}-*"):
        _discard(making)


def _discard(making: Path) -> None:
    """Remove a folder in which results were made; former ones go back unless new ones have taken their place."""
    with suppress(OSError):
        for former in (making / FORMER).iterdir():
            if not (making.parent / former.name).exists():
                former.rename(making.parent / former.name)
        shutil.rmtree(making, ignore_errors=True)

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Classes that packages register as entry points: sensors, devices, sources and nodes."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable


def registered(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, in the order of their names; nothing is loaded."""
    return {entry.name: entry for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)}


def load_class(entry: EntryPoint, base: type, refuse: Callable[..., Exception]) -> Any:
    """Return the class of an entry point.

    Raises the exception that ``refuse`` returns for a clause, and what is expected: the module does not load, or the
    class is not a ``base``.
    """
    try:
        loaded = entry.load()
    except Exception as error:  # the module of another package may raise anything
        reason = str(error).partition("\n")[0]
        raise refuse(f"{entry.value} cannot be loaded, {reason}") from error
    if not (isinstance(loaded, type) and issubclass(loaded, base)):
        raise refuse(f"{entry.value} is another class", expected=f"a subclass of {base.__name__}")
    return loaded

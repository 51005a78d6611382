"""Finds node classes by name through entry points, so that nodes of any package can be composed."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from posor_estimator.errors import ParameterError
from posor_estimator.ros.node import PosorNode

GROUP = "posor_estimator.nodes"


def node_entries() -> dict[str, EntryPoint]:
    """Return the registered node classes by name, none of them loaded."""
    return {entry.name: entry for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name)}


def node_class(name: str) -> type[PosorNode[Any]]:
    """Return the node class registered as ``name``.

    Raises:
        ParameterError: There is none, or it cannot be loaded.

    """
    entries, where = node_entries(), f"node '{name}'"
    if name not in entries:
        raise ParameterError("is unknown", where=where, expected=f"one of {', '.join(map(repr, entries))}")
    try:
        found = entries[name].load()
    except Exception as error:
        # Somebody else's module: anything can go wrong in it.
        reason = str(error).partition("\n")[0]
        raise ParameterError(f"cannot be loaded: {reason}", where=f"{where} ({entries[name].value})") from error
    if not (isinstance(found, type) and issubclass(found, PosorNode)):
        raise ParameterError("is not a node of this stack", where=where, expected="a subclass of PosorNode")
    return found

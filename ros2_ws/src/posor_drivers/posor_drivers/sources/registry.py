"""Finds sources by name through entry points."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from posor_estimator.errors import ParameterError

from posor_drivers.sources.base import Source

GROUP = "posor_drivers.sources"


def source_entries() -> dict[str, EntryPoint]:
    """Return the registered sources by name."""
    return {entry.name: entry for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name)}


def source_class(name: str) -> type[Source[Any]]:
    """Return the source registered as ``name``.

    Raises:
        ParameterError: there is none, or it cannot be loaded.

    """
    entries = source_entries()
    names = ", ".join(f"'{known}'" for known in entries)
    if name not in entries:
        raise ParameterError(f"source '{name}' is unknown", where="parameter 'source'", expected=f"one of {names}")
    try:
        found = entries[name].load()
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"source '{name}' cannot be loaded, {error}", where="parameter 'source'") from None
    if not (isinstance(found, type) and issubclass(found, Source)):
        raise ParameterError(
            f"source '{name}' is no source", where="parameter 'source'", expected="a subclass of posor_drivers' Source"
        )
    return found

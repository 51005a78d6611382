# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Libraries that only some users need, imported where they are used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError

if TYPE_CHECKING:
    from pathlib import Path


def optional_library(name: str, extra: str, where: Path | str) -> Any:
    """Return a module. Raises ParameterError: it is not installed, but ``where`` needs it.

    ``extra``: ``posor[extra]`` installs it. ``where``: file that it reads, or function that uses it.
    """
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        what = f"the Python library '{package}' is not installed"
        raise ParameterError(what, where=str(where), expected=f"pip install 'posor[{extra}]'") from None

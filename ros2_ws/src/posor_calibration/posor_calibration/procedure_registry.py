# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""All calibration procedures by name, in this order: those of every module in ``procedures``."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from posor_calibration import procedures
from posor_calibration.procedure import Procedure

_MODULES = [import_module(f"{procedures.__name__}.{module.name}") for module in iter_modules(procedures.__path__)]
_FOUND = {item.name: item for module in _MODULES for item in vars(module).values() if isinstance(item, Procedure)}

PROCEDURES: dict[str, Procedure[Any]] = dict(sorted(_FOUND.items()))

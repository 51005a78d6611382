# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fit calibration parameters, with their uncertainties, to recorded scans and a reference. No ROS here.

The names in ``__all__`` are the public Python API, imported when they are first used. All other modules are private.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posor.bags.recording import Track

    from posor_calibration.calibration_fit import FitResult, fit

__all__ = ["FitResult", "Track", "fit"]

_MODULE_OF = {"Track": "posor.bags.recording"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = getattr(import_module(_MODULE_OF.get(name, f"{__name__}.calibration_fit")), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

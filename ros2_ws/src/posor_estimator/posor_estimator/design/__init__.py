"""Design calculators: each computes a part of a POSOR or of its structure from dimensions, in SI units.

The calculators are public functions of this package, such as ``posor_estimator.design.NAME``. They need no ROS, and are
imported when they are first used. ``posor design`` runs them from the command line.
"""

from __future__ import annotations

from typing import Any

from posor_estimator.design.calculators import CALCULATORS, load_calculator

__all__ = sorted(function for _, function in CALCULATORS.values())  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Import a calculator when it is first used (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = load_calculator(name.replace("_", "-"))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__

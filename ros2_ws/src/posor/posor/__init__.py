# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""POSOR estimation: poses and covariances from the readings of position and orientation sensors.

The names in ``__all__`` are the public Python API. They need no ROS, and are imported when they are first used. All
other modules are private.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posor.bags.calibration_recording import read_scans
    from posor.bags.data_frames import to_arrow, to_dataframe
    from posor.bags.offline_pipeline import Arm, load_arm
    from posor.calibration.calibration_file import Calibration, load_calibration
    from posor.errors import (
        BagError,
        CalibrationError,
        ChainError,
        DataFileError,
        FitError,
        ParameterError,
        PosorError,
        ScanError,
        ShapeError,
    )
    from posor.estimation.estimate import Estimate, Estimates
    from posor.estimation.forward import simulate
    from posor.estimation.posor import Posor
    from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates
    from posor.model.fault import Fault, State
    from posor.model.scan import Scan, Scans
    from posor.tables.table_readings import read_table
    from posor.uncertainty.first_order import ErrorBudget, error_budget
    from posor.uncertainty.protection_level import joint_protection_levels
    from posor.uncertainty.reliability import Reliability, joint_reliability

__all__ = [
    "Arm",
    "ArmEstimates",
    "BagError",
    "Calibration",
    "CalibrationError",
    "ChainError",
    "DataFileError",
    "EndpointEstimates",
    "ErrorBudget",
    "Estimate",
    "Estimates",
    "Fault",
    "FitError",
    "ParameterError",
    "Posor",
    "PosorError",
    "Reliability",
    "Scan",
    "ScanError",
    "Scans",
    "ShapeError",
    "State",
    "error_budget",
    "joint_protection_levels",
    "joint_reliability",
    "load_arm",
    "load_calibration",
    "read_scans",
    "read_table",
    "simulate",
    "to_arrow",
    "to_dataframe",
]

_MODULES = {
    "bags.calibration_recording": ("read_scans",),
    "bags.data_frames": ("to_arrow", "to_dataframe"),
    "messages.estimate_arrays": ("ArmEstimates", "EndpointEstimates"),
    "bags.offline_pipeline": ("Arm", "load_arm"),
    "calibration.calibration_file": ("Calibration", "load_calibration"),
    "estimation.estimate": ("Estimate", "Estimates"),
    "model.fault": ("Fault", "State"),
    "estimation.forward": ("simulate",),
    "estimation.posor": ("Posor",),
    "model.scan": ("Scan", "Scans"),
    "tables.table_readings": ("read_table",),
    "uncertainty.first_order": ("ErrorBudget", "error_budget"),
    "uncertainty.protection_level": ("joint_protection_levels",),
    "uncertainty.reliability": ("Reliability", "joint_reliability"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = getattr(import_module(f"{__name__}.{_MODULE_OF.get(name, 'errors')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

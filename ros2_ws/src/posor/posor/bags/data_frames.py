# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimates and scans as named columns, pandas DataFrames and Arrow tables; both libraries are optional."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posor.errors import ParameterError
from posor.estimation.estimate import Estimates
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates
from posor.model.scan import Scans
from posor.optional_library import optional_library
from posor.uncertainty.first_order import ErrorBudget
from posor.uncertainty.reliability import Reliability

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor.numerics.array_types import FloatArray, IntArray

Result = ArmEstimates | Estimates | EndpointEstimates | Scans | ErrorBudget | Reliability
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
NATIVE = tuple(f"native_{name}" for name in ("x", "y", "gap", "alpha", "beta", "theta"))
AXES = ("x", "y", "z", "rx", "ry", "rz")
COVARIANCES = {
    f"covariances_{part}": tuple(f"cov_{part}_{row}_{column}" for row in AXES for column in AXES)
    for part in ("random", "systematic")
}
"""Columns of each covariance of x, y, z [m] and small turns about X, Y, Z [rad], row by row, by its attribute."""
STAMP_SHIFT = tuple(f"stamp_shift_{axis}" for axis in AXES)
PROTECTION_LEVEL = tuple(f"protection_level_{axis}" for axis in AXES)
JOINT_COLUMNS = {
    "scan": ("numbers", np.uint64),
    "residual": ("residuals", np.float64),
    "redundancy": ("redundancies", np.uint8),
    "state": ("states", np.uint8),
    "faults": ("faults", np.uint32),
    "scan_status": ("statuses", np.uint32),
}
"""Fields of ``posor_msgs/JointTransform`` that are columns: attribute of ``Estimates`` and type of each."""


def joint_columns(estimates: Estimates) -> dict[str, Any]:
    """Return the columns of a joint's table by name."""
    columns: dict[str, Any] = {"log_time_ns": estimates.log_times_ns, "stamp_ns": estimates.stamps_ns}
    columns |= {name: getattr(estimates, of).astype(kind) for name, (of, kind) in JOINT_COLUMNS.items()}
    columns |= _split(POSE, estimates.poses)
    columns |= _split(NATIVE, estimates.natives)
    return columns | _covariance_columns(estimates) | _split(STAMP_SHIFT, estimates.stamp_shifts)


def endpoint_columns(estimates: EndpointEstimates, joints: Sequence[str] = ()) -> dict[str, Any]:
    """Return the columns of the endpoint's table by name; ``joints``: names of the chain's joints, else numbers."""
    joints = joints or [str(n) for n in range(estimates.angles.shape[1])]
    columns: dict[str, Any] = {"log_time_ns": estimates.log_times_ns, "stamp_ns": estimates.stamps_ns}
    columns |= _split(POSE, estimates.poses) | {"degraded": estimates.degraded}
    columns |= _covariance_columns(estimates) | _split(STAMP_SHIFT, estimates.stamp_shifts)
    columns |= _split(PROTECTION_LEVEL, estimates.protection_levels)
    columns |= _split([f"angle_{joint}" for joint in joints], estimates.angles)
    return columns


def scan_columns(scans: Scans) -> dict[str, Any]:
    """Return the columns of a table of raw scans by name; readings are numbered from 0, diode currents per diode."""
    columns: dict[str, Any] = {"stamp_ns": scans.stamps_ns, "scan": scans.numbers}
    columns |= _split([f"gap_voltage_{n}" for n in range(scans.gap_voltages.shape[1])], scans.gap_voltages)
    columns |= _split([f"ring_voltage_{n}" for n in range(scans.ring_voltages.shape[1])], scans.ring_voltages)
    _, diodes, contacts = scans.diode_currents.shape
    names = [f"diode_current_{diode}_{contact}" for diode in range(diodes) for contact in "abcd"[:contacts]]
    columns |= _split(names, scans.diode_currents.reshape(len(scans), diodes * contacts))
    columns |= _split([f"lit_source_{n}" for n in range(scans.lit_sources.shape[1])], scans.lit_sources)
    columns |= {"supply_voltage": scans.supply_voltages, "temperature": scans.temperatures}
    columns |= {"reference_voltage": scans.reference_voltages}
    return columns | {"at_home": scans.at_home.astype(np.bool_)}


def _covariance_columns(estimates: Estimates | EndpointEstimates) -> dict[str, Any]:
    parts = (_split(names, getattr(estimates, of).reshape(-1, 36)) for of, names in COVARIANCES.items())
    return {name: column for part in parts for name, column in part.items()}


def _split(names: Sequence[str], numbers: FloatArray | IntArray) -> dict[str, FloatArray | IntArray]:
    return dict(zip(names, np.ascontiguousarray(numbers.T), strict=True))


def budget_columns(budget: ErrorBudget) -> dict[str, Any]:
    """Return the columns of a budget's table: a row for each contribution, its effect on each output [m, rad]."""
    parts = budget.contributions
    columns: dict[str, Any] = {
        "name": np.array([part.name for part in parts], dtype=object),
        "kind": np.array([str(part.kind) for part in parts], dtype=object),
    }
    effects = np.array([part.effects for part in parts]).reshape(-1, len(budget.outputs))
    return columns | _split([output.name for output in budget.outputs], effects)


def reliability_columns(reliability: Reliability) -> dict[str, Any]:
    """Return the columns of a reliability's table: a row for each reading."""
    columns: dict[str, Any] = {
        "name": np.array(reliability.names, dtype=object),
        "redundancy_number": reliability.redundancy_numbers,
        "bias": reliability.biases,
    }
    columns |= _split([f"gain_{axis}" for axis in AXES], reliability.gains)
    return columns | _split([f"shift_{axis}" for axis in AXES], reliability.shifts)


COLUMNS: dict[type, Callable[[Any], dict[str, Any]]] = {
    Estimates: joint_columns,
    EndpointEstimates: endpoint_columns,
    Scans: scan_columns,
    ErrorBudget: budget_columns,
    Reliability: reliability_columns,
}


def to_dataframe(data: Result) -> Any:
    """Return a pandas DataFrame of a result; for ``ArmEstimates`` a dictionary of DataFrames.

    Estimates and scans have a row for each scan, an error budget one for each contribution, a reliability one for each
    reading. Columns are named as in docs/how_to/reprocess.md; those of ``Scans`` after the fields of
    ``posor_msgs/RawScan``.

    Raises:
        ParameterError: pandas is not installed, or the data cannot be a table.

    """
    return _to_tables(data, optional_library("pandas", "tables", "to_dataframe").DataFrame)


def to_arrow(data: Result) -> Any:
    """Return a pyarrow Table with the columns of ``to_dataframe``; for ``ArmEstimates`` a dictionary of Tables.

    Raises:
        ParameterError: pyarrow is not installed, or the data cannot be a table.

    """
    return _to_tables(data, optional_library("pyarrow", "tables", "to_arrow").table)


def _to_tables(data: object, make_table: Callable[[Mapping[str, np.ndarray[Any, Any]]], Any]) -> Any:
    if isinstance(data, ArmEstimates):
        tables = {name: make_table(joint_columns(joint)) for name, joint in data.joints.items()}
        if data.chain:
            tables["endpoint"] = make_table(endpoint_columns(data.endpoint, data.chain))
        return tables
    if type(data) in COLUMNS:
        return make_table(COLUMNS[type(data)](data))
    names = ", ".join(["ArmEstimates", *(kind.__name__ for kind in COLUMNS)])
    raise ParameterError(f"data of type {type(data).__name__} cannot be a table", expected=f"one of {names}")

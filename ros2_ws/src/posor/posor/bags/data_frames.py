"""Public arrays as tables: pandas DataFrames and Arrow tables; both libraries are optional."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.estimation.estimate import Estimates
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates
from posor.messages.estimate_columns import (
    budget_columns,
    endpoint_columns,
    joint_columns,
    reliability_columns,
    scan_columns,
)
from posor.model.scan import Scans
from posor.uncertainty.first_order import ErrorBudget
from posor.uncertainty.reliability import Reliability

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np

Result = ArmEstimates | Estimates | EndpointEstimates | Scans | ErrorBudget | Reliability
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
    return _to_tables(data, _import_library("pandas", "to_dataframe").DataFrame)


def to_arrow(data: Result) -> Any:
    """Return a pyarrow Table with the columns of ``to_dataframe``; for ``ArmEstimates`` a dictionary of Tables.

    Raises:
        ParameterError: pyarrow is not installed, or the data cannot be a table.

    """
    return _to_tables(data, _import_library("pyarrow", "to_arrow").table)


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


def _import_library(name: str, function: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise ParameterError(f"the Python library '{name}' is not installed", where=function, expected=name) from None

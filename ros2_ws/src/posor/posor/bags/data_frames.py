"""Public arrays as tables: pandas DataFrames and Arrow tables; both libraries are optional."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates, JointEstimates
from posor.messages.estimate_columns import endpoint_columns, joint_columns, scan_columns
from posor.model.scan import Scans

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np


def to_dataframe(data: ArmEstimates | JointEstimates | EndpointEstimates | Scans) -> Any:
    """Return a pandas DataFrame with one row for each scan; for ``ArmEstimates`` a dictionary of DataFrames.

    Columns are named as in docs/how_to/reprocess.md; those of ``Scans`` after the fields of ``posor_msgs/RawScan``.

    Raises:
        ParameterError: pandas is not installed, or the data cannot be a table.

    """
    return _to_tables(data, _import_library("pandas", "to_dataframe").DataFrame)


def to_arrow(data: ArmEstimates | JointEstimates | EndpointEstimates | Scans) -> Any:
    """Return a pyarrow Table with one row for each scan; for ``ArmEstimates`` a dictionary of Tables.

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
    if isinstance(data, JointEstimates):
        return make_table(joint_columns(data))
    if isinstance(data, EndpointEstimates):
        return make_table(endpoint_columns(data))
    if isinstance(data, Scans):
        return make_table(scan_columns(data))
    raise ParameterError(
        f"data of type {type(data).__name__} cannot be a table",
        expected="ArmEstimates, JointEstimates, EndpointEstimates or Scans",
    )


def _import_library(name: str, function: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise ParameterError(f"the Python library '{name}' is not installed", where=function, expected=name) from None

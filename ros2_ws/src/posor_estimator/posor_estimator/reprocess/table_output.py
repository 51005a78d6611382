"""Results as tables, Parquet or CSV: one file for each joint's transforms, one for the endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor_estimator.core.types import FloatArray
    from posor_estimator.reprocess.endpoint import Endpoints
    from posor_estimator.reprocess.transforms import Transforms

TableFormat = Literal["parquet", "csv"]

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
NATIVE = tuple(f"native_{name}" for name in ("x", "y", "gap", "alpha", "beta", "theta"))
AXES = ("x", "y", "z", "rx", "ry", "rz")
COVARIANCE = tuple(f"cov_{row}_{column}" for row in AXES for column in AXES)
"""Of x, y, z [m] and small turns about X, Y, Z [rad], row by row: ROS order (``posor_msgs/JointTransform``)."""
AS_THEY_ARE = ("scan", "residual", "redundancy", "state", "faults", "scan_status")


class TableOutput:
    """Writes a folder of tables."""

    def __init__(
        self, folder: Path, kind: TableFormat, transforms: Sequence[str], joints: Sequence[str] | None
    ) -> None:
        """Create the files.

        Args:
            folder: Where; not yet there.
            kind: Of the files.
            transforms: Names of the joints that have transforms.
            joints: Names of the chain's joints; None: there is no chain.

        """
        folder.mkdir()
        self._tables = {name: _Table(folder / f"{name}.{kind}", kind) for name in transforms}
        self._joints = joints
        self._endpoint = None if joints is None else _Table(folder / f"endpoint.{kind}", kind)

    def write(self, transforms: Mapping[str, Transforms], endpoints: Endpoints | None) -> None:
        """Write what a block has given."""
        for name, each in transforms.items():
            self._tables[name].write(_of_transforms(each))
        if self._endpoint is not None and endpoints is not None and self._joints is not None:
            columns: dict[str, Any] = {"log_time_ns": endpoints.times_ns, "stamp_ns": endpoints.stamps_ns}
            columns |= _columns(POSE, endpoints.poses)
            columns |= _columns(COVARIANCE, endpoints.covariances.reshape(-1, 36))
            columns |= _columns([f"angle_{joint}" for joint in self._joints], endpoints.angles)
            self._endpoint.write(columns)

    def close(self) -> None:
        """Write what belongs at the end of the files."""
        for table in [*self._tables.values(), self._endpoint]:
            if table is not None:
                table.close()


class _Table:
    """One file; made with its first rows."""

    def __init__(self, path: Path, kind: TableFormat) -> None:
        self._path = path
        self._kind = kind
        self._writer: Any = None

    def write(self, columns: Mapping[str, Any]) -> None:
        batch = pa.RecordBatch.from_arrays([pa.array(column) for column in columns.values()], names=list(columns))
        if self._writer is None:
            self._writer = (
                pa.csv.CSVWriter(self._path, batch.schema)
                if self._kind == "csv"
                else pa.parquet.ParquetWriter(self._path, batch.schema, compression="zstd", use_dictionary=False)
            )
        self._writer.write(batch)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


def _of_transforms(transforms: Transforms) -> dict[str, Any]:
    table = transforms.table
    columns: dict[str, Any] = {"log_time_ns": transforms.times_ns, "stamp_ns": transforms.stamps_ns}
    columns |= {name: np.ascontiguousarray(table[name]) for name in AS_THEY_ARE}
    columns |= _columns(POSE, table.span("pose.position.x", 7))
    columns |= _columns(NATIVE, table["native"])
    columns |= _columns(COVARIANCE, table["covariance"])
    return columns


def _columns(names: Sequence[str], numbers: FloatArray) -> dict[str, FloatArray]:
    """Return the columns of an array (n, k) by their names."""
    turned = np.ascontiguousarray(numbers.T)
    return dict(zip(names, turned, strict=True))

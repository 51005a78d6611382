"""Results as tables, Parquet or CSV: one file for each joint's transforms, one for the endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from posor.messages.estimate_columns import endpoint_columns, joint_columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.messages.estimate_arrays import ArmEstimates

TableFormat = Literal["parquet", "csv"]


class TableOutput:
    """Writes a folder of tables."""

    def __init__(self, folder: Path, kind: TableFormat, joints: Sequence[str], chain: Sequence[str] | None) -> None:
        """Create the files.

        Args:
            folder: Does not exist yet.
            kind: Format of the files.
            joints: Names of the joints.
            chain: Names of the chain's joints; None: no chain.

        """
        folder.mkdir()
        self._tables = {name: _Table(folder / f"{name}.{kind}", kind) for name in joints}
        self._endpoint = None if chain is None else _Table(folder / f"endpoint.{kind}", kind)

    def write(self, estimates: ArmEstimates) -> None:
        """Write the estimates of a block."""
        for name, joint in estimates.joints.items():
            self._tables[name].write(joint_columns(joint))
        if self._endpoint is not None:
            self._endpoint.write(endpoint_columns(estimates.endpoint, estimates.chain))

    def close(self) -> None:
        """Write what belongs at the end of the files."""
        for table in [*self._tables.values(), self._endpoint]:
            if table is not None:
                table.close()


class _Table:
    """One file; created with its first rows."""

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

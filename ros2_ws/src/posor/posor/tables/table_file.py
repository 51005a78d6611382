# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Open a table of any format that a map can read: text, Parquet, TDMS, MATLAB."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.errors import DataFileError, ParameterError, clause_of
from posor.input_text import check_input_file, read_input_bytes
from posor.optional_library import optional_library
from posor.tables.raw_table import ArrayTable, Column
from posor.tables.table_units import stated_unit
from posor.tables.text_table import TextTable, decode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from posor.tables.raw_table import RawTable
    from posor.tables.table_map import FileLayout

LARGEST_TEXT, LARGEST_FILE = 1 << 31, 1 << 36  # [bytes]
_MAGIC_BYTES = 24
_MATRIX = 2  # dimensions


def open_table(path: Path, layout: FileLayout, *, growing: bool = False) -> RawTable:
    """Open a table; its content, not its name, decides on the format.

    ``growing``: another program is still writing the table; a last line without end is left out.

    Raises:
        DataFileError: The file cannot be read, is of another format, or is growing and no text.
        ParameterError: The library of an optional format is not installed.

    """
    found = _binary_format(path)
    if found is None:
        return TextTable(path, decode(read_bytes(path), layout.encoding, str(path), growing=growing), layout)
    if growing:
        what = f"is a {found[0]} file, which cannot be read while another program writes it"
        raise DataFileError(what, where=str(path), expected="a text file, or no parameter 'follow'")
    return _read_binary(path, *found)


def is_text(path: Path) -> bool:
    """Return whether a table is a text file. Raises the errors of ``open_table``."""
    return _binary_format(path) is None


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a text file. Raises DataFileError: it cannot be read."""
    try:
        return read_input_bytes(path, LARGEST_TEXT)
    except OSError as error:
        raise DataFileError(f"cannot be read, {(error.strerror or str(error)).lower()}", where=str(path)) from None


def _binary_format(path: Path) -> tuple[str, Callable[[Path], RawTable]] | None:
    """Return name and reader of a file's format; None: text."""
    try:
        check_input_file(path, LARGEST_FILE)
        with path.open("rb") as file:
            magic = file.read(_MAGIC_BYTES)
    except OSError as error:
        raise DataFileError(f"cannot be read, {(error.strerror or str(error)).lower()}", where=str(path)) from None
    for begin, what in _REFUSED.items():
        if magic.startswith(begin):
            raise DataFileError(what, where=str(path), expected="a CSV, Parquet, TDMS or MATLAB file")
    for begin, found in _READERS.items():
        if magic.startswith(begin) and (begin or path.suffix.lower() == ".mat"):
            return found
    return None


def _read_binary(path: Path, kind: str, reader: Callable[[Path], RawTable]) -> RawTable:
    """Return a table; whatever a library raises about a damaged file becomes one sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return reader(path)
    except (DataFileError, ParameterError):
        raise
    except Exception as error:
        raise DataFileError(f"is not a whole {kind} file, {clause_of(error)}", where=str(path)) from error


def _parquet(path: Path) -> RawTable:
    parquet, arrow = optional_library("pyarrow.parquet", "tables", path), optional_library("pyarrow", "tables", path)
    table = parquet.ParquetFile(path).read()
    columns = []
    for field, chunks in zip(table.schema, table.columns, strict=True):
        stated = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        kind = field.type
        if arrow.types.is_dictionary(kind):
            chunks = chunks.cast(kind.value_type)  # noqa: PLW2901
        if arrow.types.is_timestamp(kind):
            array = _iso(chunks.cast(arrow.timestamp("ns")).to_numpy(), zone="Z" if kind.tz else "")
        elif arrow.types.is_decimal(kind):
            array = np.array([None if cell is None else str(cell) for cell in chunks.to_pylist()], dtype=object)
        elif arrow.types.is_nested(kind):  # each cell is invalid, with the type in the error
            array = np.full(len(chunks), str(kind), dtype=object)
        elif arrow.types.is_duration(kind):
            stated, array = kind.unit, _exact(chunks.cast(arrow.int64()))
        else:
            array = _exact(chunks.cast(arrow.int8()) if arrow.types.is_boolean(kind) else chunks)
        columns.append((Column(field.name, *stated_unit(field.name, stated)), array))
    return ArrayTable(path, columns)


def _exact(chunks: Any) -> NDArray[Any]:
    """Return a column of Parquet; whole numbers stay exact beside cells without a value."""
    if chunks.null_count and str(chunks.type).lstrip("u").startswith("int"):
        return np.array(chunks.to_pylist(), dtype=object)
    array: NDArray[Any] = chunks.to_numpy()
    return array


def _tdms(path: Path) -> RawTable:
    tdms = optional_library("nptdms", "tdms", path).TdmsFile.read(path)
    columns: list[tuple[Column, NDArray[Any]]] = []
    for group in tdms.groups():
        for channel in group.channels():
            name, properties = f"{group.name}/{channel.name}", channel.properties
            unit = stated_unit(channel.name, str(properties.get("unit_string", "")))
            interval = properties.get("wf_increment")
            array = channel[:]
            if array.dtype.kind == "M":
                array = _iso(array, zone="Z")
            begin = f"{properties.get('wf_start_time', '')} + {float(properties.get('wf_start_offset', 0.0)):g} s"
            columns.append((Column(name, *unit, *((float(interval), begin) if interval else ())), array))
    incomplete = tdms.file_status.incomplete_final_segment
    return ArrayTable(path, columns, note="the last segment of the TDMS file is incomplete" if incomplete else "")


def _iso(times: NDArray[Any], zone: str) -> NDArray[Any]:
    """Return times as texts."""
    return np.array(
        [f"{text}{zone}" if text != "NaT" else "" for text in np.datetime_as_string(times, unit="ns")], dtype=object
    )


def _matlab(path: Path) -> RawTable:
    from scipy.io import loadmat  # noqa: PLC0415  takes time to load

    return _of_variables(path, loadmat(path, simplify_cells=True))


def _matlab_73(path: Path) -> RawTable:
    h5py = optional_library("h5py", "matlab", path)

    def content(node: Any) -> Any:
        if isinstance(node, h5py.Group):
            return {name: content(part) for name, part in node.items() if not name.startswith("#")}
        kind = node.attrs.get("MATLAB_class", b"double")
        array = node[()]
        if node.attrs.get("MATLAB_empty") or (kind not in (b"double", b"single", b"logical") and b"int" not in kind):
            return None
        return np.atleast_1d(np.squeeze(np.transpose(array)))

    with h5py.File(path, "r") as file:
        return _of_variables(path, content(file))


def _of_variables(path: Path, variables: Mapping[str, Any]) -> RawTable:
    """Return the vectors, and the columns of matrices, of the variables and of structs of them."""
    columns = [
        (Column(name, *stated_unit(name)), array)
        for name, array in _columns_of("", {k: v for k, v in variables.items() if not k.startswith("__")})
    ]
    if not columns:
        expected = "vectors, matrices or structs of numbers, not objects such as table or datetime"
        raise DataFileError("holds no arrays of numbers", where=str(path), expected=expected)
    return ArrayTable(path, columns)


def _columns_of(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _columns_of(f"{name}.{key}".lstrip("."), part)
    elif isinstance(value, int | float | np.number):
        yield name, np.array([value])  # one row
    elif isinstance(value, np.ndarray) and value.dtype.names is None and value.dtype.kind in "biufOU":
        if value.ndim == 1:
            yield name, value
        elif value.ndim == _MATRIX:
            yield from ((f"{name}(:,{n + 1})", value[:, n]) for n in range(value.shape[1]))


_READERS: dict[bytes, tuple[str, Callable[[Path], RawTable]]] = {
    b"PAR1": ("Parquet", _parquet),
    b"TDSm": ("TDMS", _tdms),
    b"MATLAB 7.3": ("MATLAB", _matlab_73),
    b"\x89HDF": ("MATLAB", _matlab_73),
    b"MATLAB": ("MATLAB", _matlab),
    b"": ("MATLAB", _matlab),  # version 4 has no mark
}
_REFUSED = {
    b"PK\x03\x04": "is a ZIP archive, such as a workbook of Excel",
    b"\xd0\xcf\x11\xe0": "is a workbook of Excel",
    b"\x1f\x8b": "is compressed with gzip",
    b"\x28\xb5\x2f\xfd": "is compressed with zstd",
    b"\x89MCAP": "is an MCAP bag",
    b"SQLite format 3": "is an SQLite bag",
}

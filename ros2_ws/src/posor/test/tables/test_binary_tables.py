# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of Parquet, TDMS and MATLAB files, written with the libraries of these formats, by the same map."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor import DataFileError, ParameterError, read_table
from posor.tables.table_readings import load_readings
from scipy.io import savemat

from .sample_files import CELSIUS, COUNT, NAMES, START, TIMES, VOLTS, write_map
from .test_text_tables import check_scans

COLUMNS = dict(zip(NAMES, [TIMES, 1e3 * VOLTS[:, 0], 1e3 * VOLTS[:, 1], CELSIUS, ["ok"] * COUNT], strict=True))
SHORT = {"t": TIMES, "gap": 1e3 * VOLTS, "plate": CELSIUS}


def joints(names: tuple[str, str, str]) -> dict[str, Any]:
    gaps = [{"column": name, "unit": "mV"} for name in names[:2]]
    return {"elbow": {"frame_id": "plate", "gap_voltages": gaps, "temperature": {"column": names[2], "unit": "degC"}}}


OF_MATLAB = {
    "time": {"column": "daq.t", "unit": "s", "start": START},
    "joints": joints(("daq.gap(:,1)", "daq.gap(:,2)", "daq.plate")),
}


def write_parquet(path: Path) -> dict[str, Any]:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet  # noqa: PLC0415

    columns = {
        **COLUMNS,
        "When": pa.array(
            np.datetime64(START[:-1], "ns") + np.round(1e9 * TIMES).astype(np.int64), pa.timestamp("ns", tz="UTC")
        ),
    }
    pyarrow.parquet.write_table(pa.table(columns), path)
    return {"time": {"column": "When", "format": "iso"}}


def write_tdms(path: Path, rate: float = 500.0) -> dict[str, Any]:
    nptdms = pytest.importorskip("nptdms")
    properties = {"wf_increment": 1.0 / rate, "unit_string": "mV"}
    channels = [nptdms.ChannelObject("DAQ", f"AI{n}", 1e3 * VOLTS[:, n], properties) for n in range(2)]
    channels.append(nptdms.ChannelObject("DAQ", "Plate", CELSIUS, {"unit_string": "°C"}))
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)
    return {
        "time": {"rate": {"value": 500.0, "unit": "Hz"}, "start": START},
        "joints": joints(("DAQ/AI0", "DAQ/AI1", "DAQ/Plate")),
    }


def write_mat5(path: Path) -> dict[str, Any]:
    savemat(path, {"daq": SHORT})
    return OF_MATLAB


def write_mat4(path: Path) -> dict[str, Any]:
    savemat(path, SHORT, format="4")
    return {"time": {"column": "t", "unit": "s", "start": START}, "joints": joints(("gap(:,1)", "gap(:,2)", "plate"))}


def write_mat73(path: Path) -> dict[str, Any]:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in SHORT.items():
            node = file.create_dataset(f"daq/{name}", data=np.atleast_2d(array.T))
            node.attrs["MATLAB_class"] = np.bytes_(b"double")
        remark = file.create_dataset("daq/remark", data=np.array([[111], [107]], dtype=np.uint16))
        remark.attrs["MATLAB_class"] = np.bytes_(b"char")
    with path.open("r+b") as mat:
        mat.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return OF_MATLAB


WRITERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "a.parquet": write_parquet,
    "a.tdms": write_tdms,
    "v4.mat": write_mat4,
    "v5.mat": write_mat5,
    "v73.mat": write_mat73,
    "without_suffix": write_parquet,
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_scans(name: str, tmp_path: Path) -> None:
    changes = WRITERS[name](tmp_path / name)
    check_scans(read_table(tmp_path / name, write_map(tmp_path, **changes)))


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [("a.parquet", "pyarrow.parquet", "tables"), ("a.tdms", "nptdms", "tdms"), ("v73.mat", "h5py", "matlab")],
)
def test_a_missing_library_is_named_with_its_extra(
    name: str, module: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = WRITERS[name](tmp_path / name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ParameterError) as caught:
        read_table(tmp_path / name, write_map(tmp_path, **changes))
    library = module.partition(".")[0]
    expected = f"the Python library '{library}' is not installed; expected pip install 'posor[{extra}]'."
    assert str(caught.value) == f"{tmp_path / name}: {expected}"


@pytest.mark.parametrize("name", [name for name in WRITERS if "." in name])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_file_is_refused(name: str, share: float, tmp_path: Path) -> None:
    changes = WRITERS[name](tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(DataFileError) as caught:
        read_table(tmp_path / name, write_map(tmp_path, **changes))
    assert "\n" not in str(caught.value)


def test_an_incomplete_segment_is_left_out_if_the_map_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.tdms"
    changes = write_tdms(path)
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:-40])
    table_map = write_map(tmp_path, **changes)
    with pytest.raises(DataFileError, match=r"the last segment of the TDMS file is incomplete"):
        read_table(path, table_map)
    readings = load_readings(path, write_map(tmp_path, **changes, leave_out=["incomplete_rows"]))
    assert readings.left_out == {"incomplete_rows": 1}
    assert len(readings.joints["elbow"].scans) == 2 * COUNT - 5


def test_the_rate_of_the_file_contradicts_the_map(tmp_path: Path) -> None:
    path = tmp_path / "a.tdms"
    with pytest.raises(DataFileError, match=r"rate 500 Hz, but column 'DAQ/AI0' has 250 Hz; expected 250 Hz\."):
        read_table(path, write_map(tmp_path, **write_tdms(path, 250.0)))


def test_missing_values_and_columns_of_other_lengths(tmp_path: Path) -> None:
    path = tmp_path / "v5.mat"
    gap = SHORT["gap"].copy()
    gap[3, 0], gap[5, 1] = np.nan, np.inf
    savemat(path, {"daq": SHORT | {"gap": gap}})
    with pytest.raises(DataFileError, match=r"row 6, column 'daq\.gap\(:,2\)': 'inf' is invalid"):
        read_table(path, write_map(tmp_path, **OF_MATLAB))
    readings = load_readings(path, write_map(tmp_path, **OF_MATLAB, leave_out=["missing_cells", "invalid_cells"]))
    assert readings.left_out == {"missing_cells": 1, "invalid_cells": 1}
    assert readings.joints["elbow"].scans.numbers.tolist() == [1, 2, 3, 5, 7, 8, 9, 10]
    savemat(path, {"daq": SHORT | {"plate": CELSIUS[:-1]}})
    with pytest.raises(DataFileError, match=r"'daq\.t' has 10 rows; expected 9, as column 'daq\.plate'"):
        read_table(path, write_map(tmp_path, **OF_MATLAB))
    savemat(path, {"text": "no numbers"})
    with pytest.raises(DataFileError, match="holds no arrays of numbers"):
        read_table(path, write_map(tmp_path, **OF_MATLAB))


def test_types_of_parquet_columns(tmp_path: Path) -> None:
    """Whole numbers stay exact beside empty cells, durations have a unit, and lists are named."""
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet  # noqa: PLC0415

    path, epoch_ns = tmp_path / "a.parquet", 1_795_600_800_000_000_001
    joint = {"elbow": {"frame_id": "plate", "gap_voltages": [{"column": "u", "unit": "V"}]}}

    def stamps(times: Any, unit: str, volts: Any) -> list[int]:
        pyarrow.parquet.write_table(pa.table({"t": times, "u": volts}), path)
        time = {"column": "t", "unit": unit, "start": "1970-01-01T00:00:00Z"}
        written = write_map(tmp_path, time=time, joints=joint, leave_out=["missing_cells"])
        return [int(stamp) for stamp in read_table(path, written).stamps_ns]

    assert stamps(pa.array([epoch_ns, None, epoch_ns + 2]), "ns", [0.1, 0.2, 0.3]) == [epoch_ns, epoch_ns + 2]
    durations = pa.array([7, 9], pa.duration("ms"))
    assert stamps(durations, "ms", pa.array([True, None])) == [7_000_000]
    for times, unit, volts, sentence in (
        (durations, "s", [0.1, 0.2], "column 't' is in ms by the file, in s by the map"),
        ([1.0, 2.0], "s", [[0.1], [0.2]], "'list<element: double>' is invalid"),
    ):
        with pytest.raises(DataFileError, match=sentence):
            stamps(times, unit, volts)


def test_a_decimal_comma_in_a_text_of_parquet_has_no_key_of_text_files_as_remedy(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet  # noqa: PLC0415

    path = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(pa.table(COLUMNS | {NAMES[1]: ["715,767"] * COUNT}), path)
    with pytest.raises(DataFileError, match=r"row 1, column 'AI0 \(mV\)'") as caught:
        read_table(path, write_map(tmp_path))
    assert "decimal:" not in str(caught.value)


def test_a_matlab_file_of_one_row(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"daq": {"t": 0.0, "u": 0.71, "v": -0.25, "plate": 20.0}})
    time = {"column": "daq.t", "unit": "s", "start": START}
    scans = read_table(
        tmp_path / "a.mat", write_map(tmp_path, time=time, joints=joints(("daq.u", "daq.v", "daq.plate")))
    )
    np.testing.assert_allclose(scans.gap_voltages, [[0.71e-3, -0.25e-3]])


@pytest.mark.parametrize("other", [{"wf_start_offset": 0.001}, {"wf_start_time": np.datetime64("2026-11-25T10:00:00")}])
def test_channels_of_tdms_that_were_not_sampled_together_are_refused(tmp_path: Path, other: dict[str, Any]) -> None:
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "a.tdms"
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            nptdms.ChannelObject("DAQ", f"AI{n}", VOLTS[:, n], {"wf_increment": 0.002, "unit_string": "V"} | added)
            for n, added in enumerate(({}, other))
        )
    joint = {"elbow": {"frame_id": "plate", "gap_voltages": [{"column": f"DAQ/AI{n}", "unit": "V"} for n in range(2)]}}
    time = {"rate": {"value": 500.0, "unit": "Hz"}, "start": START}
    with pytest.raises(DataFileError, match="column 'DAQ/AI1' begins at"):
        read_table(path, write_map(tmp_path, time=time, joints=joint))

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checksums of MCAP bags, damaged and cut files, and their recovery, against rosbags' reading of the undamaged file."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pytest
import yaml
from posor.bags import recover_command
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import BagWriter, TopicMessages, file_name_of
from posor.bags.block_reader import read_messages
from posor.bags.mcap_file import OF_MESSAGES, Damage, read_index
from posor.bags.mcap_search import read_records
from posor.bags.provenance import PENDING
from posor.bags.recorded_topics import METADATA
from posor.bags.recover_command import Rescue, recover
from posor.errors import BagError, OutputError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN
from posor_lab.harness.recorded_messages import read_bag
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin, Writer

from .bag_files import TOPICS, WANTED, Record, by_blocks, chunk_indices, write

CHUNKS, IN_CHUNK = 24, 6
ADVICE = "expected an undamaged file; 'recover' of posor writes what is whole to a new bag."
COMPRESSIONS = [CompressionMode.NONE, CompressionMode.STORAGE]


def chunks() -> list[list[Record]]:
    """Return messages chunk by chunk; their bytes are random."""
    chance, made = np.random.default_rng(17), []
    for chunk in range(CHUNKS):
        first = 1000 * chunk
        made.append([(TOPICS[n % 3], first + n, chance.bytes(int(chance.integers(40, 90)))) for n in range(IN_CHUNK)])
    return made


def first_damage(file: Path) -> Damage | None:
    """Return the first damaged place of a file; None: the file is whole."""
    return next((piece for piece in read_records(file.read_bytes()) if isinstance(piece, Damage)), None)


def record(path: Path) -> Path:
    """Write the messages as the recorder does, and return the file."""
    definition = MessageTypes().definition(RAW_SCAN)
    with BagWriter(path) as writer:
        for topic in TOPICS:
            writer.add_topic(topic, RAW_SCAN, definition)
        for chunk in chunks():
            for topic, time_ns, data in chunk:
                writer.write(topic, time_ns, data)
            writer.flush()
    return path / file_name_of(path)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of an undamaged file."""
    return record(tmp_path_factory.mktemp("recorded") / "bag").read_bytes()


def rescued(bag: Path, output: Path) -> tuple[list[Rescue], list[Record]]:
    """Recover a bag; return what was found, and the messages of the new bag as rosbags reads them."""
    rescues = recover(bag, output)
    return rescues, read_bag(output)


def test_chunks_and_index_state_their_checksums(tmp_path: Path) -> None:
    file = record(tmp_path / "bag")
    data, infos = file.read_bytes(), chunk_indices(file)
    assert len(infos) == CHUNKS
    for info in infos:
        begin = info.chunk_start_offset
        records = data[begin + 49 : begin + info.chunk_length]
        assert int.from_bytes(data[begin + 33 : begin + 37], "little") == crc32(records) != 0
    index_at = int.from_bytes(data[-28:-20], "little")
    assert int.from_bytes(data[-12:-8], "little") == crc32(data[index_at:-12]) != 0
    assert first_damage(file) is None
    assert [data for _, _, data in read_bag(tmp_path / "bag")] == [data for chunk in chunks() for *_, data in chunk]


def test_chunks_written_from_tables_state_their_checksums(tmp_path: Path) -> None:
    messages = np.frombuffer(np.random.default_rng(5).bytes(50 * 64), dtype=np.uint8).reshape(50, 64)
    with BagWriter(tmp_path / "bag") as writer:
        topic = writer.add_topic(TOPICS[0], RAW_SCAN, MessageTypes().definition(RAW_SCAN))
        for begin in (0, 20):
            part = slice(begin, begin + 30)
            writer.write_messages([TopicMessages(topic, np.arange(50)[part], messages[part])])
    file = tmp_path / "bag/bag_0.mcap"
    data = bytearray(file.read_bytes())
    assert first_damage(file) is None
    for info in chunk_indices(file):
        spoilt = data.copy()
        spoilt[info.chunk_start_offset + 100] ^= 1
        file.write_bytes(spoilt)
        damage = first_damage(file)
        assert damage is not None
        assert (damage.offset, damage.what) == (info.chunk_start_offset, "a chunk is damaged: chunk checksum mismatch")


def read_both_ways(bag: Path) -> tuple[list[Any], list[Record], list[Record]]:
    """Return the topics of a bag, and its messages as both readers read them."""
    with opened_bag(bag) as reader:
        topics = [tuple(connection)[:-1] for connection in reader.connections]
        one = [(each.topic, time_ns, data) for each, time_ns, data in read_messages(reader, WANTED, str(bag))]
    return topics, one, list(by_blocks(bag))


def read_or_refusal(bag: Path) -> tuple[list[Any], list[Record], list[Record]] | str:
    try:
        return read_both_ways(bag)
    except BagError as error:
        return str(error)


@pytest.mark.parametrize("flips", [40, pytest.param(200, marks=pytest.mark.long)])
def test_no_flipped_bit_changes_what_is_read_without_an_error(recorded: bytes, tmp_path: Path, flips: int) -> None:
    bag = tmp_path / "bag"
    file, chance, refused = record(bag), np.random.default_rng(29), 0
    known = read_both_ways(bag)
    for _ in range(flips):
        data, at = bytearray(recorded), int(chance.integers(len(recorded)))
        data[at] ^= 1 << int(chance.integers(8))
        file.write_bytes(data)
        found = read_or_refusal(bag)
        if isinstance(found, str):
            refused += 1
            assert found.startswith(f"{file}, byte ")
            assert found.endswith(ADVICE)
        else:
            assert found == known
    assert refused > flips // 2


def test_the_error_of_a_damaged_chunk_names_file_and_offset(recorded: bytes, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    file = record(bag)
    info, data = chunk_indices(file)[7], bytearray(recorded)
    data[info.chunk_start_offset + 80] ^= 4
    file.write_bytes(data)
    for read in (lambda: list(by_blocks(bag)), lambda: read_both_ways(bag)):
        with pytest.raises(BagError) as caught:
            read()
        where = f"{file}, byte {info.chunk_start_offset}"
        assert str(caught.value) == f"{where}: a chunk is damaged: chunk checksum mismatch; {ADVICE}"


def check_cuts(recorded: bytes, folder: Path, count: int) -> None:
    """Cut the file at random places; compare with the chunks that end before the cut."""
    file, chance = record(folder / "bag"), np.random.default_rng(31)
    ends = [info.chunk_start_offset + info.chunk_length for info in chunk_indices(file)]
    cut, contents = folder / "cut.mcap", chunks()
    for length in chance.integers(8, len(recorded), size=count).tolist():
        cut.write_bytes(recorded[:length])
        whole = [message for end, chunk in zip(ends, contents, strict=True) if end <= length for message in chunk]
        if whole:
            (rescue,), messages = rescued(cut, folder / "out")
            assert messages == whole
            assert (rescue.messages, rescue.stated, rescue.lost) == (len(whole), None, {})
            assert rescue.damages or length >= ends[-1]
            shutil.rmtree(folder / "out")
        else:
            with pytest.raises(BagError, match=r"holds no whole message, the file .*cut short"):
                recover(cut, folder / "out")
            assert not (folder / "out").exists()


def test_every_whole_chunk_of_a_cut_file_is_rescued(recorded: bytes, tmp_path: Path) -> None:
    check_cuts(recorded, tmp_path, 15)


@pytest.mark.long
def test_every_whole_chunk_of_200_cut_files_is_rescued(recorded: bytes, tmp_path: Path) -> None:
    check_cuts(recorded, tmp_path, 200)


@pytest.mark.parametrize("flip", [(0, 2), (1, 128)], ids=["type of a message", "length"])
def test_a_damaged_message_index_costs_no_message(flip: tuple[int, int], recorded: bytes, tmp_path: Path) -> None:
    file, data = record(tmp_path / "bag"), bytearray(recorded)
    first = chunk_indices(file)[0]
    data[first.chunk_start_offset + first.chunk_length + flip[0]] ^= flip[1]
    file.write_bytes(data)
    (rescue,), messages = rescued(tmp_path / "bag", tmp_path / "out")
    assert messages == [message for chunk in chunks() for message in chunk]
    assert rescue.damages == []


def check_flips(recorded: bytes, folder: Path, count: int) -> None:
    """Flip bits; every chunk but the damaged one is rescued, and the loss is counted."""
    file, chance, contents = record(folder / "bag"), np.random.default_rng(37), chunks()
    infos = chunk_indices(file)
    for _ in range(count):
        data, at = bytearray(recorded), int(chance.integers(len(recorded)))
        data[at] ^= 1 << int(chance.integers(8))
        file.write_bytes(data)
        inside = [0 <= at - each.chunk_start_offset < each.chunk_length for each in infos]
        (rescue,), messages = rescued(folder / "bag", folder / "out")
        whole = [message for hit, chunk in zip(inside, contents, strict=True) if not hit for message in chunk]
        everything = [message for chunk in contents for message in chunk]
        assert messages == whole or (messages == everything and not rescue.damages)
        if rescue.stated is not None:
            assert rescue.stated == CHUNKS * IN_CHUNK
        if any(inside) and messages == whole:
            begin = infos[inside.index(True)].chunk_start_offset
            assert [damage.offset for damage in rescue.damages] == [begin]
        shutil.rmtree(folder / "out")


def test_all_chunks_but_the_damaged_one_are_rescued(recorded: bytes, tmp_path: Path) -> None:
    check_flips(recorded, tmp_path, 15)


@pytest.mark.long
def test_all_chunks_but_the_damaged_one_are_rescued_from_200_files(recorded: bytes, tmp_path: Path) -> None:
    check_flips(recorded, tmp_path, 200)


@pytest.mark.parametrize("mode", COMPRESSIONS)
def test_files_of_rosbags_without_checksums_are_rescued(tmp_path: Path, mode: CompressionMode) -> None:
    write(tmp_path / "bag", chunks(), mode=mode)
    file = tmp_path / "bag/bag.mcap"
    infos, data = chunk_indices(file), file.read_bytes()
    cut_at = infos[5].chunk_start_offset + 20
    file.write_bytes(data[:cut_at])
    (rescue,), messages = rescued(tmp_path / "bag", tmp_path / "out")
    assert messages == [message for chunk in chunks()[:5] for message in chunk]
    assert [damage.offset for damage in rescue.damages] == [cut_at - 20, cut_at]


def test_messages_outside_of_chunks_are_rescued(recorded: bytes, tmp_path: Path) -> None:
    records = b"".join(
        bytes([opcode]) + len(content).to_bytes(8, "little") + content
        for piece in read_records(recorded)
        if not isinstance(piece, Damage)
        for opcode, content in piece
        if opcode in OF_MESSAGES
    )
    (tmp_path / "flat.mcap").write_bytes(recorded[:8] + records[:-10])
    (rescue,), messages = rescued(tmp_path / "flat.mcap", tmp_path / "out")
    assert messages == [message for chunk in chunks() for message in chunk][:-1]
    assert rescue.stated is None


def test_topics_come_from_the_index_if_the_chunk_that_defines_them_is_damaged(recorded: bytes, tmp_path: Path) -> None:
    file = record(tmp_path / "bag")
    info, data = chunk_indices(file)[0], bytearray(recorded)
    data[info.chunk_start_offset + 200] ^= 1
    file.write_bytes(data)
    with Reader(record(tmp_path / "whole").parent) as reader:
        known = [(each.topic, each.msgtype, each.msgdef, each.digest, each.ext) for each in reader.connections]
    (rescue,), messages = rescued(tmp_path / "bag", tmp_path / "out")
    assert messages == [message for chunk in chunks()[1:] for message in chunk]
    damaged = f"{file}, byte {info.chunk_start_offset}: a chunk is damaged: chunk checksum mismatch"
    assert rescue.lines() == [
        f"{file}: {(CHUNKS - 1) * IN_CHUNK} messages rescued",
        f"{damaged}; {rescue.damages[0].size} bytes lost",
        f"{file}: {IN_CHUNK} of {CHUNKS * IN_CHUNK} messages lost",
    ]
    with Reader(tmp_path / "out") as reader:
        assert [(each.topic, each.msgtype, each.msgdef, each.digest, each.ext) for each in reader.connections] == known
    file.write_bytes(data[:-1])
    with pytest.raises(BagError, match="holds no whole message"):
        recover(tmp_path / "bag", tmp_path / "nothing")


def test_the_program_says_what_is_lost_and_keeps_the_custom_data(
    recorded: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "killed"
    bag.mkdir()
    (bag / "killed.mcap").write_bytes(recorded[: len(recorded) // 2])
    (bag / PENDING).write_text(json.dumps({"posor.urdf": "ab12"}))
    with pytest.raises(BagError, match=r"metadata\.yaml is missing .*'recover' of posor"), opened_bag(bag):
        pass
    assert recover_command.main([str(bag), "--output", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{bag}/killed.mcap: ")
    assert lines[-2:] == [
        f"{bag}/killed.mcap: its index states no number of messages, so that of lost ones is not known.",
        f"written to {tmp_path}/out",
    ]
    metadata = yaml.safe_load((tmp_path / "out" / METADATA).read_text())["rosbag2_bagfile_information"]
    assert metadata["custom_data"] == {"posor.urdf": "ab12"}
    assert recover_command.main([str(bag), "--output", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == f"{tmp_path}/out: exists already; expected a new folder.\n"


def test_what_cannot_be_recovered_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "other.mcap").write_bytes(bytes(range(256)) * 9)
    (tmp_path / "notes.txt").touch()
    for name, sentence in (
        ("none", r"none: does not exist; expected an MCAP file, or a folder of MCAP files\."),
        ("notes.txt", r"notes\.txt: holds no MCAP file; expected an MCAP file; for SQLite: 'sqlite3 \.recover'"),
        ("empty.mcap", r"empty\.mcap: holds no whole message, the file is empty at byte 0\."),
        ("other.mcap", "the file does not begin as MCAP files do at byte 0"),
    ):
        with pytest.raises(BagError, match=sentence):
            recover(tmp_path / name, tmp_path / "out")
        assert not (tmp_path / "out").exists()


def test_an_index_without_a_checksum_is_read(tmp_path: Path) -> None:
    write(tmp_path / "bag", chunks())
    assert isinstance(read_index((tmp_path / "bag/bag.mcap").read_bytes()), list)
    assert len(read_both_ways(tmp_path / "bag")[1]) == CHUNKS * IN_CHUNK * 2 // 3


def test_an_undamaged_bag_of_several_files_is_copied_whole(tmp_path: Path) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    text, type_hash = MessageTypes().definition(RAW_SCAN)
    for number in (0, 2, 10):
        with Writer(tmp_path / f"part{number}", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topic = writer.add_connection(TOPICS[0], RAW_SCAN, msgdef=text, rihs01=type_hash)
            writer.write(topic, number, bytes([number]))
        (tmp_path / f"part{number}/part{number}.mcap").rename(folder / f"x_{number}.mcap")
    rescues, messages = rescued(folder, tmp_path / "out")
    assert [rescue.path.name for rescue in rescues] == ["x_0.mcap", "x_2.mcap", "x_10.mcap"]
    assert [data for *_, data in messages] == [b"\x00", b"\x02", b"\x0a"]
    assert all(rescue.stated == rescue.messages == 1 for rescue in rescues)


def test_a_missing_file_of_a_split_bag_is_named(
    recorded: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    (folder / "x_0.mcap").write_bytes(recorded)
    listed = {"relative_file_paths": ["x_0.mcap.zstd", "x_1.mcap"]}
    (folder / METADATA).write_text(yaml.safe_dump({"rosbag2_bagfile_information": listed}), encoding="utf-8")
    assert recover_command.main([str(folder), "--output", str(tmp_path / "out")]) == 0
    lost = [line for line in capsys.readouterr().out.splitlines() if "lists" in line]
    assert lost == [f"{folder}/x_1.mcap: lost; metadata.yaml lists it, but there is no such MCAP file."]


def test_a_full_disk_is_named_and_nothing_is_left(
    recorded: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real_open = Path.open

    def onto_full_disk(path: Path, mode: str = "r", **options: Any) -> Any:
        return real_open(Path("/dev/full"), "wb") if mode == "xb" else real_open(path, mode, **options)

    (tmp_path / "bag.mcap").write_bytes(recorded)
    monkeypatch.setattr(Path, "open", onto_full_disk)
    with pytest.raises(OutputError, match="out: cannot be written, No space left on device"):
        recover(tmp_path / "bag.mcap", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    with pytest.raises(BagError, match=r"pipe\.mcap: is neither a folder nor a file"), opened_bag(pipe):
        pass
    with pytest.raises(BagError, match=r"pipe\.mcap: is not a file; expected an MCAP file"):
        recover(pipe, tmp_path / "out")


def test_a_wrong_place_of_an_index_without_a_checksum_hides_no_chunk(tmp_path: Path) -> None:
    write(tmp_path / "bag", chunks())
    file = tmp_path / "bag/bag.mcap"
    data, infos = bytearray(file.read_bytes()), chunk_indices(file)
    data[-28:-20] = infos[3].chunk_start_offset.to_bytes(8, "little")
    file.write_bytes(data)
    assert len(rescued(tmp_path / "bag", tmp_path / "out")[1]) == CHUNKS * IN_CHUNK

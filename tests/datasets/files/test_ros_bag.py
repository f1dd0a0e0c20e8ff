"""Packed ROS recordings: what they hold is read, and what becomes too much is an error before it fills the memory."""

import bz2
import shutil
import sqlite3
import struct
from contextlib import closing, nullcontext

import pytest
from lz4 import frame as lz4
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from torchjoint.datasets.files import ros_bag
from torchjoint.datasets.files.ros_bag import Bag, unpack
from torchjoint.runtime import bounds

TEXT = "a" * 300_000  # packs well
TYPE = "std_msgs/msg/String"


def ros_1(path, compression):
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbag1.Writer(path)
    writer.set_compression(compression)
    with writer:
        topic = writer.add_connection("/text", TYPE, typestore=store)
        writer.write(topic, 0, store.serialize_ros1(store.types[TYPE](TEXT), TYPE))


def ros_2(path, mode, storage):
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = rosbag2.Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/text", TYPE, typestore=store)
        writer.write(topic, 0, store.serialize_cdr(store.types[TYPE](TEXT), TYPE))


@pytest.mark.parametrize(
    ("name", "write", "arguments"),
    [
        ("walk.bag", ros_1, (rosbag1.Writer.CompressionFormat.BZ2,)),
        ("walk.bag", ros_1, (rosbag1.Writer.CompressionFormat.LZ4,)),
        ("walk", ros_2, (CompressionMode.STORAGE, StoragePlugin.MCAP)),
        ("walk", ros_2, (CompressionMode.MESSAGE, StoragePlugin.SQLITE3)),
        ("walk", ros_2, (CompressionMode.FILE, StoragePlugin.SQLITE3)),
    ],
)
def test_packed_recordings(name, write, arguments, tmp_path, monkeypatch):
    write(tmp_path / name, *arguments)
    assert Bag(tmp_path / name).first("/text").data == TEXT
    monkeypatch.setattr(bounds, "FREE", 100_000)
    monkeypatch.setattr(bounds, "RATIO", 1)
    with pytest.raises(
        ValueError, match=r"walk.*: not a whole ROS recording: .*(packed bytes have more than 10\d{4}|unpacked)"
    ):
        Bag(tmp_path / name).first("/text")


@pytest.mark.parametrize(
    "change",
    [
        "DROP TABLE schema; CREATE VIEW schema AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) "
        "SELECT count(*) AS schema_version FROM c",
        "ALTER TABLE messages ADD COLUMN more BLOB AS (zeroblob(990000000))",
    ],
)
def test_a_database_that_computes(change, tmp_path):
    ros_2(tmp_path / "walk", CompressionMode.NONE, StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(tmp_path / "walk" / "walk.db3")) as database:
        database.executescript(change)
    with pytest.raises(ValueError, match=r"walk: not a whole ROS recording: .* computed, maybe without end"):
        Bag(tmp_path / "walk").first("/text")


def test_a_page_that_is_in_a_database_many_times(tmp_path):
    """A table of four such levels has 10^11 rows in 340 kB; to count them takes days, and Ctrl-C does not end it."""
    ros_2(tmp_path / "walk", CompressionMode.NONE, StoragePlugin.SQLITE3)
    file = tmp_path / "walk" / "walk.db3"
    with closing(sqlite3.connect(file)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (size,) = database.execute("PRAGMA page_size").fetchone()
    data, count = bytearray(file.read_bytes()), file.stat().st_size // size
    place = slice((root - 1) * size, root * size)
    leaf, table = data[place], bytearray(size)
    child = struct.pack(">IB", count + 1, 127)  # the new page, and the largest key in it
    table[:12] = struct.pack(">BHHHBI", 5, 0, 600, size - 8, 0, count + 1)
    table[12:1212], table[size - 8 : size - 3] = 600 * struct.pack(">H", size - 8), child
    data[place], data[28:32] = table, struct.pack(">I", count + 1)
    file.write_bytes(data + leaf)
    with pytest.raises(ValueError, match=r"walk: not a whole ROS recording: .*expected a whole database, got .*page"):
        Bag(tmp_path / "walk")


@pytest.mark.parametrize(("times", "is_refused"), [(1, False), (40, True)])
def test_chunks_of_one_time_are_unpacked_together(times, is_refused, tmp_path, monkeypatch):
    """An index may name a chunk any number of times, and rosbags holds all that begin before the first one ends."""
    ros_2(tmp_path / "walk", CompressionMode.STORAGE, StoragePlugin.MCAP)
    file = tmp_path / "walk" / "walk.mcap"
    data = file.read_bytes()
    (at,) = struct.unpack("<Q", data[-28:-20])  # of the summary
    head, chunks = data[:at], b""
    while data[at] != 2:  # the end
        end = at + 9 + struct.unpack("<Q", data[at + 1 : at + 9])[0]
        chunks += data[at:end] * (times if data[at] == 8 else 1)
        at = end
    file.write_bytes(head + chunks + data[at:])
    monkeypatch.setattr(bounds, "FREE", 2_000_000)
    for path in (tmp_path / "walk", file):
        with pytest.raises(ValueError, match=r"expected at most .* unpacked") if is_refused else nullcontext():
            assert Bag(path).first("/text").data == TEXT


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_file_that_the_description_does_not_list_is_told(tmp_path, storage):
    """A recorder that was killed has not listed its last file."""
    ros_2(tmp_path / "walk", CompressionMode.NONE, storage)
    Bag(tmp_path / "walk")
    (whole,) = (tmp_path / "walk").glob("walk.*")
    shutil.copy(whole, whole.with_stem("walk_1"))
    with pytest.warns(UserWarning, match=rf"walk: walk_1{whole.suffix}: not in metadata\.yaml, so it is not read"):
        Bag(tmp_path / "walk")


def test_messages_in_a_journal_are_not_left_out(tmp_path):
    """A recorder that was killed leaves its last messages in a file beside the database."""
    ros_2(tmp_path / "walk", CompressionMode.NONE, StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(tmp_path / "walk" / "walk.db3")) as database:
        database.executescript(
            "PRAGMA journal_mode = wal; INSERT INTO messages SELECT 9, topic_id, 9, data FROM messages"
        )
        shutil.copytree(tmp_path / "walk", tmp_path / "killed")
    for path in (tmp_path / "killed", tmp_path / "killed" / "walk.db3"):
        with pytest.raises(ValueError, match=r"expected a database that was closed, got walk\.db3-wal beside it"):
            Bag(path)
    with closing(sqlite3.connect(tmp_path / "killed" / "walk.db3")) as database:
        database.execute("SELECT count(*) FROM messages").fetchall()
    assert len(list(Bag(tmp_path / "killed").messages("/text"))) == 2


@pytest.mark.parametrize("name", ["a#b", "a?b", "100% of it", "a%41", "..%2fother%2f"])
def test_a_database_of_any_name(name, tmp_path):
    """SQLite gets a URI; the last name would lead out of the folder."""
    ros_2(tmp_path / "walk", CompressionMode.NONE, StoragePlugin.SQLITE3)
    (tmp_path / "walk" / "walk.db3").rename(tmp_path / "walk" / f"{name}.db3")
    description = tmp_path / "walk" / "metadata.yaml"
    description.write_text(description.read_text().replace("walk.db3", f"'{name}.db3'"))
    (tmp_path / "walk").rename(tmp_path / name)
    assert Bag(tmp_path / name).first("/text").data == TEXT


def test_a_file_that_is_listed_twice(tmp_path):
    """A short description could list one file 100,000 times, and each of them would be opened."""
    ros_2(tmp_path / "walk", CompressionMode.NONE, StoragePlugin.MCAP)
    description = tmp_path / "walk" / "metadata.yaml"
    description.write_text(description.read_text().replace("  - walk.mcap", "  - walk.mcap\n  - other/walk.mcap"))
    with pytest.raises(ValueError, match=r"walk: not a whole ROS recording: .*file 'walk\.mcap' is there twice"):
        Bag(tmp_path / "walk")


def of_type(path, text):
    """A recording with a message of a type that it defines."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text if "module" not in text else "uint8 data\n", TYPE))
    with rosbag2.Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/text", TYPE, msgdef=text, rihs01=store.hash_rihs01(TYPE))
        writer.write(topic, 0, b"\0\1\0\0" + bytes(64))


def of_number(number):
    module = f"module std_msgs {{ module msg {{ const uint32 N = {number}; struct String {{ uint8 data; }}; }}; }};\n"
    return f"{'=' * 80}\nIDL: {TYPE}\n{module}"


PART = f"{'=' * 80}\nMSG: std_msgs/Part\nuint8"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("string[5000] data\n", "expected at most 4096 texts and messages in all arrays"),
        (f"Part[5000] data\n{PART} data\n", "expected at most 4096 texts and messages in all arrays"),
        (f"Part[9] data\n{PART}[0] data\n", "expected arrays of at least one element"),
        (of_number("1 << 99"), "expected at most 64 bits to shift by, got 99"),
        (of_number("4294967296 * 4294967297"), f"expected at most {1 << 64} as a number"),
    ],
)
def test_types_that_fill_the_memory(text, message, tmp_path):
    """A recording defines its types; rosbags makes a program of them."""
    of_type(tmp_path / "walk", text)
    with pytest.raises(ValueError, match=f"walk: not a whole ROS recording: .*{message}"):
        Bag(tmp_path / "walk").first("/text")


def test_a_library_without_a_place_for_the_bounds_is_refused(tmp_path, monkeypatch):
    ros_2(tmp_path / "walk", CompressionMode.MESSAGE, StoragePlugin.SQLITE3)
    monkeypatch.delattr("rosbags.rosbag2.reader.zstd")
    with pytest.raises(ModuleNotFoundError, match="needs rosbags: installed, but does not load"):
        Bag(tmp_path / "walk").first("/text")


@pytest.mark.parametrize(
    ("pack", "make"), [(bz2.compress, bz2.BZ2Decompressor), (lz4.compress, lz4.LZ4FrameDecompressor)]
)
@pytest.mark.parametrize("step", [1000, 1 << 24])
def test_the_bound_is_exact(pack, make, step, monkeypatch):
    monkeypatch.setattr(ros_bag, "STEP", step)
    packed = pack(bytes(5000)) + pack(b"ab")  # two streams
    assert unpack(make, packed) == bytes(5000) + b"ab"
    monkeypatch.setattr(bounds, "RATIO", 0)
    monkeypatch.setattr(bounds, "FREE", 5002)
    assert len(unpack(make, packed)) == 5002
    monkeypatch.setattr(bounds, "FREE", 5001)
    with pytest.raises(ValueError, match=f"^{len(packed)} packed bytes have more than 5001"):
        unpack(make, packed)
    with pytest.raises(ValueError, match="packed bytes are truncated"):
        unpack(make, pack(bytes(4000))[:-3])


def test_many_streams_take_no_square_of_time():
    fed = []

    class Unpacker:
        eof, needs_input, unused_data = False, True, b""

        def decompress(self, piece, max_length):
            fed.append(len(piece))
            self.eof, self.unused_data = True, piece[1:]
            return piece[:1]

    assert unpack(Unpacker, b"ab" * 5000) == b"ab" * 5000
    assert sum(fed) <= 10_000 * 1024  # not 50 million

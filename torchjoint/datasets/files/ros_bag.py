"""Reads the messages of a ROS 1 or ROS 2 recording (.bag, .mcap, .db3, or a folder with metadata.yaml) with rosbags.

rosbags has no limit for what compressed parts of a recording become in memory; here they have one.
"""

import bz2
import os
import re
import sqlite3
import struct
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cache
from itertools import accumulate, islice
from pathlib import Path
from threading import Lock
from types import SimpleNamespace
from typing import Any, NamedTuple
from urllib.parse import quote

import yaml

from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import has_file, has_folder, no_twice, present, read_file
from torchjoint.runtime.messages import needed_for

#: Suffixes of a recording in one file, and of the files that a ROS 2 recording's folder lists.
SUFFIXES = (".bag", ".mcap", ".db3")
#: Bytes that are unpacked at a time: lz4 allocates so many in advance.
STEP = 1 << 24
#: Messages of a topic come in the order of their headers' times up to this, seconds, unless a clock was set back.
SET_BACK = 1.0


class Stamp(NamedTuple):
    """Identifies a message, so that it can be read again."""

    time: float  #: seconds, from the message's header: when the sensor measured, not when it was recorded
    recorded: int  #: nanoseconds, when it was recorded
    place: int  #: its index among the topic's messages that were recorded at this time


class Bag:
    """A recording; one thread at a time reads it.

    Its files stay open: opening them takes longer than reading an image.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = Lock()
        self._reader: Any = None
        self._process = 0  #: id of the process that opened the files; a forked process opens its own
        with self._opened() as reader:
            self.kinds: dict[str, str] = {}  #: types of the topics that have messages
            self.counts: Counter[str] = Counter()  #: messages of each topic
            for one in sorted(reader.connections, key=lambda one: one.topic):
                if one.msgcount:
                    self.kinds[one.topic] = one.msgtype
                    self.counts[one.topic] += one.msgcount

    def __reduce__(self) -> tuple[type["Bag"], tuple[Path]]:  # a worker opens the files itself
        return Bag, (self.path,)

    def __del__(self) -> None:
        if getattr(self, "_reader", None) is not None and self._process == os.getpid():
            with suppress(Exception):  # a damaged file may raise anything
                self._reader.close()

    def topics(self, *kinds: str) -> list[str]:
        """The topics of any of these types, such as "sensor_msgs/msg/Image"."""
        return [topic for topic, kind in self.kinds.items() if kind in kinds]

    def messages(self, topic: str) -> Iterator[Any]:
        """All messages of a topic, in the order of the recording."""
        with self._opened() as reader:
            for connection, _, data in reader.messages(_connections(reader, topic)):
                yield reader.deserialize(data, connection.msgtype)

    def first(self, topic: str) -> Any:
        """The first message of a topic."""
        for message in self.messages(topic):
            return message
        raise ValueError(f"{self.path}: expected messages of topic {topic}, got none")

    def stamps(self, topic: str) -> list[Stamp]:
        """The messages of a topic that have a header, sorted by time; of equal times only the first.

        Raises:
            ValueError: they have different frames, so one pose and one camera do not fit all.

        Warns:
            UserWarning: the clock was set back between two of them.
        """
        found, places, frames = dict[float, Stamp](), Counter[int](), set[str]()
        before = back = 0.0
        with self._opened() as reader:
            for _, recorded, data in reader.messages(_connections(reader, topic)):
                time, frame = _header(data, reader.is2)
                frames.add(frame)
                before, back = time, max(back, before - time)
                found.setdefault(time, Stamp(time, recorded, places[recorded]))
                places[recorded] += 1
        if len(frames) > 1:
            told = f"got {', '.join(map(repr, sorted(frames)[:5]))}; write a topic for each"
            raise ValueError(f"{self.path}: {topic}: expected messages of one frame (frame_id), {told}")
        if back > SET_BACK:
            told = f"{self.path}: {topic}: the time of the headers goes back by {back:.1f} s between two messages"
            warnings.warn(f"{told}: images, depth and poses are matched by it, perhaps wrongly", stacklevel=3)
        return [found[time] for time in sorted(found)]

    def read(self, topic: str, stamp: Stamp) -> Any:
        """Reads one message again."""
        with self._opened() as reader:
            some = reader.messages(_connections(reader, topic), start=stamp.recorded, stop=stamp.recorded + 1)
            for connection, _, data in islice(some, stamp.place, None):
                return reader.deserialize(data, connection.msgtype)
        raise ValueError(f"{self.path}: expected a message of topic {topic} at {stamp.time:.3f} s, found none")

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        with self._lock, _clear_errors(self.path):
            if self._process != os.getpid():
                self._reader, self._process = _open(self.path), os.getpid()
            yield self._reader


def _open(path: Path) -> Any:
    """Opens a reader of rosbags; it closes its files when it is garbage-collected."""
    with needed_for("reading ROS recordings", "rosbags", "torchjoint[ros]"):
        from rosbags.highlevel import AnyReader
        from rosbags.rosbag2.reader import zstd  # noqa: F401  others have no place for our bounds
        from rosbags.typesys import Stores, get_typestore
    bound_unpacking(_check_files(path))
    check_databases()
    bound_definitions()
    # Recordings of ROS 2 before Iron do not contain the definitions of their messages.
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    reader.open()
    try:
        _check_arrays(reader.typestore.fielddefs)
        if reader.is2:
            _check_chunks(reader.readers[0].storage)
    except ValueError:
        reader.close()
        raise
    return reader


def _check_arrays(types: Mapping[str, Any]) -> None:
    """Checks the arrays in a recording's own types of messages, before rosbags makes a program of them.

    That has lines for each element, unless these are numbers. An element without bytes may be there any number of
    times.
    """
    arrays = [field[1] for _, fields in types.values() for _, field in fields if field[0].name == "ARRAY"]
    lines = sum(length for element, length in arrays if element[0].name == "NAME" or element[1][0] == "string")
    bounds.check(lines, bounds.PROPERTIES, "texts and messages in all arrays of fixed lengths")
    if any(length < 1 for _, length in arrays):
        raise ValueError("expected arrays of at least one element")


def _check_chunks(storage: Any) -> None:
    """Checks what rosbags holds at a time, unpacked: the chunks of one time in the index of an MCAP file."""
    from rosbags.rosbag2.storage_mcap import McapReader

    for file in (one for one in getattr(storage, "storages", (storage,)) if isinstance(one, McapReader)):
        begin = [(one.message_start_time, one.uncompressed_size) for one in file.chunks]
        end = [(max(one.message_start_time, one.message_end_time) + 1, -one.uncompressed_size) for one in file.chunks]
        held = accumulate(size for _, size in sorted(begin + end))
        bounds.check_unpacked(max(held, default=0), file.path.stat().st_size)


@cache
def bound_definitions() -> None:
    """Makes rosbags compute no number beyond 64 bits in a definition: `1 << 99999999999` fills the memory."""
    from rosbags.typesys import idl

    evaluate = idl.eval_expression

    def evaluated(expression: Any, *rest: Any) -> Any:
        if getattr(expression, "op", None) == "<<" and hasattr(expression, "right"):
            expression = expression._replace(right=evaluated(expression.right, *rest))
            bounds.check(expression.right.value, 64, "bits to shift by")
        value = evaluate(expression, *rest)
        if isinstance(value.value, int):
            bounds.check(abs(value.value), 1 << 64, "as a number")
        return value

    idl.eval_expression = evaluated


@cache
def check_databases() -> None:
    """Makes rosbags look at a database before it asks it, and find it if its path has characters of a URI."""
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    open_database = Sqlite3Reader.open

    def opened(reader: Any) -> None:
        for one in (Path(f"{reader.path}-{end}") for end in ("wal", "journal")):
            if has_file(one) and read_file(one, "a journal")[:1] not in (b"", b"\0"):
                raise ValueError(f"expected a database that was closed, got {one.name} beside it: open it with sqlite3")
        size = reader.path.stat().st_size
        reader.path = Path(quote(str(reader.path)))  # a part of a URI, where ..%2f would lead out of the folder
        with closing(sqlite3.connect(f"file:{reader.path}?immutable=1", uri=True)) as database:
            for kind, text in database.execute("SELECT type, sql FROM sqlite_master"):
                if kind not in ("table", "index") or re.search(r"\b(as|virtual)\b", text or "", re.IGNORECASE):
                    raise ValueError(f"expected plain tables, got a {kind} that is computed, maybe without end")
            # A page may be in a tree any number of times. To look for it takes seconds in a gigabyte.
            told = database.execute("PRAGMA quick_check(1)").fetchone() if size < bounds.FREE else ("ok",)
            if told != ("ok",):
                raise ValueError(f"expected a whole database, got {' '.join(told[0].split())}")
        open_database(reader)

    Sqlite3Reader.open = opened


def _check_files(path: Path) -> int:
    """Checks the files of a recording, which the library opens itself: no device, no pipe, no endless YAML.

    Returns:
        the bytes of all.
    """
    if not has_folder(path):
        return present(path, "a ROS recording").stat().st_size
    text = read_file(path / "metadata.yaml", "the description of a ROS recording", bounds.YAML_BYTES)
    files = yaml.load(text, yaml.BaseLoader)["rosbag2_bagfile_information"]["relative_file_paths"]
    no_twice((Path(file).name for file in files), "metadata.yaml: file")  # each is opened as often as it is listed
    listed = {Path(file).name.removesuffix(".zstd") for file in files}
    for name in sorted({one.name for one in path.iterdir() if one.suffix in SUFFIXES} - listed):
        warnings.warn(f"{path}: {name}: not in metadata.yaml, so it is not read (`ros2 bag reindex`)", stacklevel=2)
    return sum(file.stat().st_size for file in path.iterdir() if has_file(file))


@contextmanager
def _clear_errors(path: Path) -> Iterator[None]:
    """Turns any error of a library about damaged bytes into a ValueError that names the recording."""
    try:
        yield
    except (ModuleNotFoundError, FileNotFoundError):
        raise
    except Exception as error:  # errors of rosbags, apsw, lz4, zstd, YAML; MemoryError if a size is damaged
        if str(error).startswith(f"{path}: "):
            raise
        raise ValueError(f"{path}: not a whole ROS recording: {type(error).__name__}: {error}") from error


def _connections(reader: Any, topic: str) -> Sequence[Any]:
    return [connection for connection in reader.connections if connection.topic == topic]


def _header(data: bytes, is_ros2: bool) -> tuple[float, str]:
    """The time in a message's header, seconds, and its frame; the message, maybe a large image, is not decoded.

    ROS 2 writes four bytes about the encoding, then seconds and nanoseconds. ROS 1 writes a number, then the same two.
    """
    order = "<" if not is_ros2 or data[1] & 1 else ">"
    seconds, nanoseconds, length = struct.unpack_from(f"{order}{'i' if is_ros2 else 'I'}II", data, 4)
    frame = bytes(data[16 : 16 + min(length, 200)]).decode(errors="replace").rstrip("\0").lstrip("/")
    return float(seconds + nanoseconds * 1e-9), frame


def unpack(make: Callable[[], Any], packed: bytes) -> bytes:
    """Decompresses bytes.

    Args:
        make: makes a decompressor, such as bz2.BZ2Decompressor; each stream in the bytes gets a new one.
        packed: a chunk of a recording, or a message.
    """
    most = bounds.RATIO * len(packed) + bounds.FREE
    parts, count, place = [], 0, 0
    while place < len(packed):
        unpacker, size = make(), 1 << 10  # a few bytes first: what follows a stream is copied
        while not unpacker.eof:
            piece = packed[place : place + size] if unpacker.needs_input else b""
            if unpacker.needs_input and not piece:
                raise ValueError("packed bytes are truncated")
            parts.append(unpacker.decompress(piece, max_length=min(STEP, most + 1 - count)))
            count, place, size = count + len(parts[-1]), place + len(piece), 2 * size
            if count > most:
                raise ValueError(f"{len(packed)} packed bytes have more than {most} when they are unpacked")
        place -= len(unpacker.unused_data or b"")
    return b"".join(parts)


def bound_unpacking(size: int) -> None:
    """Makes rosbags use :func:`unpack` for chunks (ROS 1, MCAP) and messages (ROS 2), and bounds its temporary files.

    Args:
        size: bytes of all files of the recording that is opened next.
    """
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as ros_1
    from rosbags.rosbag2 import reader as ros_2
    from rosbags.rosbag2 import storage_mcap as mcap

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    ros_1.decompressors["bz2"] = lambda packed: unpack(bz2.BZ2Decompressor, packed)
    ros_1.decompressors["lz4"] = lambda packed: unpack(LZ4FrameDecompressor, packed)
    mcap.DECOMPRESSORS["lz4"] = lambda packed, _: unpack(LZ4FrameDecompressor, packed)
    mcap.DECOMPRESSORS["zstd"] = lambda packed, _: unpack(zstd.ZstdDecompressor, packed)
    written = 0

    def copy(packed: Any, unpacked: Any) -> None:
        nonlocal written
        for part in iter(lambda: packed.read(STEP), b""):
            written += unpacked.write(part)
            bounds.check_unpacked(written, size)

    ros_2.shutil = SimpleNamespace(copyfileobj=copy)  # for files that are packed as a whole
    messages: Any = SimpleNamespace(open=zstd.open, decompress=lambda packed: unpack(zstd.ZstdDecompressor, packed))
    ros_2.zstd = messages

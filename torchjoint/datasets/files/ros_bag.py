"""Reads the messages of a ROS 1 or ROS 2 recording (.bag, .mcap, .db3, or a folder with metadata.yaml) with rosbags."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

from torchjoint.datasets.files.ros_packing import bound_unpacking
from torchjoint.runtime.extras import needed_for

#: Of a file, and of the files that a ROS 2 recording's folder lists.
SUFFIXES = (".bag", ".mcap", ".db3")


class Stamp(NamedTuple):
    """A message that can be read again."""

    time: float  #: seconds, of the message's header: when it was taken, not when it was recorded
    recorded: int  #: nanoseconds
    place: int  #: among the topic's messages that were recorded at this time


class Bag:
    """A recording; one thread reads it at a time. Its files stay open: to open them takes longer than to read an image.

    Raises:
        FileNotFoundError: there is no such path.
        ValueError: (from every method) a damaged recording; the message names it.
        ModuleNotFoundError: rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = Lock()
        self._reader: Any = None
        self._process = 0  #: that opened the files; a forked process opens its own
        with self._opened() as reader:
            self.kinds: dict[str, str] = {}  #: topics with messages, and their types
            for one in sorted(reader.connections, key=lambda one: one.topic):
                if one.msgcount:
                    self.kinds[one.topic] = one.msgtype

    def __del__(self) -> None:
        if getattr(self, "_reader", None) is not None and self._process == os.getpid():
            with suppress(Exception):  # of a damaged file
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
        with self._opened() as reader:
            for connection, _, data in reader.messages(_connections(reader, topic)):
                return reader.deserialize(data, connection.msgtype)
        raise ValueError(f"{self.path}: expected messages of topic {topic}, got none")

    def stamps(self, topic: str) -> list[Stamp]:
        """The messages of a topic with a header, by time; of equal times the first."""
        found: dict[float, Stamp] = {}
        before, place = -1, 0
        with self._opened() as reader:
            for _, recorded, data in reader.messages(_connections(reader, topic)):
                place = place + 1 if recorded == before else 0
                before = recorded
                time = _header_time(data, reader.is2)
                found.setdefault(time, Stamp(time, recorded, place))
        return [found[time] for time in sorted(found)]

    def read(self, topic: str, stamp: Stamp) -> Any:
        """One message again."""
        with self._opened() as reader:
            some = reader.messages(_connections(reader, topic), start=stamp.recorded, stop=stamp.recorded + 1)
            for place, (connection, _, data) in enumerate(some):
                if place == stamp.place:
                    return reader.deserialize(data, connection.msgtype)
        raise ValueError(f"{self.path}: expected a message of topic {topic} at {stamp.time:.3f} s, which is gone")

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        with self._lock, _clear_errors(self.path):
            if self._process != os.getpid():
                self._reader, self._process = _open(self.path), os.getpid()
            yield self._reader


def _open(path: Path) -> Any:
    """An open reader of rosbags, which closes its files when nobody holds it."""
    with needed_for("reading ROS recordings", "rosbags", "torchjoint[ros]"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    if not path.exists():
        raise FileNotFoundError(f"{path}: missing; expected a ROS recording")
    bound_unpacking()
    # Recordings of ROS 2 before Iron do not say what their messages hold.
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
    reader.open()
    return reader


@contextmanager
def _clear_errors(path: Path) -> Iterator[None]:
    """Whatever a library raises about damaged bytes becomes a ValueError that names the recording."""
    try:
        yield
    except (ModuleNotFoundError, FileNotFoundError):
        raise
    except Exception as error:  # of rosbags, apsw, lz4, zstd, YAML; assertions; MemoryError of sizes that are not there
        if str(error).startswith(f"{path}: "):
            raise
        raise ValueError(f"{path}: not a whole ROS recording: {type(error).__name__}: {error}") from error


def _connections(reader: Any, topic: str) -> Sequence[Any]:
    return [connection for connection in reader.connections if connection.topic == topic]


def _header_time(data: bytes, is_ros2: bool) -> float:
    """Seconds of a message's header, without decoding what may be a large image.

    ROS 2 writes four bytes about the encoding, then seconds and nanoseconds; ROS 1 a number, then these.
    """
    order = "<" if not is_ros2 or data[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}{'i' if is_ros2 else 'I'}I", data, 4)
    return float(seconds + nanoseconds * 1e-9)

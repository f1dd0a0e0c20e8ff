"""PCD files, written from the format's description with nothing of the reader's code."""

import struct

import numpy as np


def write_pcd(path, fields, *, data="binary", width=None, height=1):
    """Writes a cloud; `fields` are arrays [N] or [N, count] by name, as their types are."""
    columns = {name: np.asarray(values) for name, values in fields.items()}
    count = len(next(iter(columns.values())))
    kinds = {"f": "F", "i": "I", "u": "U"}
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(columns),
        "SIZE": " ".join(str(column.dtype.itemsize) for column in columns.values()),
        "TYPE": " ".join(kinds[column.dtype.kind] for column in columns.values()),
        "COUNT": " ".join(str(column[0].size) for column in columns.values()),
        "WIDTH": width or count,
        "HEIGHT": height,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": count,
        "DATA": data,
    }
    header = "# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in lines.items())
    path.write_bytes(header.encode() + BODIES[data](columns))
    return path


def ascii_body(columns):
    rows = zip(*(column.reshape(len(column), -1).tolist() for column in columns.values()), strict=True)
    return "".join(" ".join(str(value) for values in row for value in values) + "\n" for row in rows).encode()


def binary_body(columns):
    rows = zip(*columns.values(), strict=True)
    return b"".join(value.tobytes() for row in rows for value in row)


def compressed_body(columns):
    raw = b"".join(column.tobytes() for column in columns.values())
    packed = compress_lzf(raw)
    return struct.pack("<II", len(packed), len(raw)) + packed + bytes(5)  # writers leave something behind


BODIES = {"ascii": ascii_body, "binary": binary_body, "binary_compressed": compressed_body}


def compress_lzf(data):
    """LZF: copies of what came before where three bytes are the same, else bytes as they are."""
    out, literal, place, seen = bytearray(), bytearray(), 0, {}

    def flush():
        for start in range(0, len(literal), 32):
            run = literal[start : start + 32]
            out.extend([len(run) - 1, *run])
        literal.clear()

    while place < len(data):
        earlier = seen.get(data[place : place + 3])
        seen[data[place : place + 3]] = place
        length = 0
        if earlier is not None and place - earlier <= 8192:
            while length < 264 and place + length < len(data) and data[earlier + length] == data[place + length]:
                length += 1
        if length < 3:
            literal.append(data[place])
            place += 1
            continue
        flush()
        back = place - earlier - 1
        long = [length - 2 - 7] if length - 2 >= 7 else []
        out.extend([(min(length - 2, 7) << 5) | (back >> 8), *long, back & 255])
        place += length
    flush()
    return bytes(out)

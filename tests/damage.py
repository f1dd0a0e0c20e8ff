"""Damaged files, and what errors about them must be."""

import re
import struct
import warnings

import numpy as np

#: A clear error of a file that cannot be read is one of these, and names the file or the argument.
CLEAR = (ValueError, FileNotFoundError, TypeError)

#: What is told of data that are read in part.
TOLD = ".*(not (applied|read|used)|left out|taken (for all images|from the nearest points)|read as a cloud alone)"

#: Numbers in text that no tensor, or no float, has.
HUGE = (b"999999999999", b"%d" % 2**63, b"%d" % 2**64, b"-%d" % (2**63 + 1), b"1" + bytes(400).replace(b"\0", b"0"))


def damage(data, rng):
    """One way of many to spoil a file's bytes."""
    kind, place = rng.integers(5), int(rng.integers(max(len(data), 1)))
    if kind == 0:
        return data[:place]
    if kind == 1:
        return data[:place] + data[place + 1 :]
    if kind == 2:  # a number somewhere becomes huge, or negative
        huge = struct.pack("<Q", [0xFFFFFFFFFFFFFFFF, 0x7FFFFFFF, 1 << 40, 1 << 62][rng.integers(4)])
        return data[:place] + huge[: 4 if rng.integers(2) else 8] + data[place + 8 :]
    if kind == 3:  # digits of text become huge
        numbers = list(re.finditer(rb"\d+", data))
        if numbers:
            chosen = numbers[rng.integers(len(numbers))]
            return data[: chosen.start()] + HUGE[rng.integers(len(HUGE))] + data[chosen.end() :]
    spoiled = bytearray(data)
    for _ in range(1 + int(rng.integers(8))):
        if spoiled:
            spoiled[rng.integers(len(spoiled))] ^= 1 << rng.integers(8)
    return bytes(spoiled)


def damages(folder, times, seed=0):
    """Spoils every file below a folder in turn, so many times; the caller reads in between, warnings being errors."""
    rng = np.random.default_rng(seed)
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        whole = file.read_bytes()
        for _ in range(times):
            file.write_bytes(damage(whole, rng))
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # an odd byte is no reason to print something either
                warnings.filterwarnings("ignore", TOLD)
                yield file
        file.write_bytes(whole)

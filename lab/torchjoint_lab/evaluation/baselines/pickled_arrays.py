"""Reads pickles of arrays and numbers safely: a function that a pickle names is never called.

A pickle is a program that may name any function and call it. This module has its own virtual machine, which supports
only the few instructions for lists of plain arrays; it implements the functions that they need itself.
All other instructions are rejected. A value takes about as much memory as its bytes in the file.
"""

from __future__ import annotations

import math
import pickletools
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

_NAMES = {"numpy dtype": "dtype", "numpy ndarray": "ndarray", "_codecs encode": "encode"}
for _core in ("core", "_core"):  # before NumPy 2, and since NumPy 2
    _NAMES |= {f"numpy.{_core}.multiarray {name}": name for name in ("_reconstruct", "scalar")}
    _NAMES |= {f"numpy.{_core}.numeric _frombuffer": "_frombuffer"}
_LITERALS = (
    "BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT", "SHORT_BINBYTES", "BINBYTES", "BINBYTES8",
    "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "BYTEARRAY8",
)  # fmt: skip
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_NUMBERS = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")

#: NumPy's own limit.
_MOST_AXES = 64


def read_pickled_arrays(path: Path) -> list[Any]:
    """Reads a pickle of one array, or of a list or tuple of arrays, numbers and bytes (protocol 2 or later).

    Returns:
        The items of the list or tuple; for a single array, the items of its first axis.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a truncated file, or a pickle with any other content.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a pickle of arrays")
    try:
        value = _plain(_Machine().run(path.read_bytes()))
        items = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
        return [_checked(_plain(item)) for item in items]
    except (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError) as error:
        raise ValueError(f"{path}: not a pickle of arrays and numbers alone: {error!r}") from error


class _Name(str):
    """The name of a function in a pickle; the function itself is never looked up."""


class _Type:
    """A NumPy type of plain numbers, while it is built."""

    def __init__(self, code: str) -> None:
        if code not in _NUMBERS:
            raise ValueError(f"an array of type {_shown(code)}")
        self._code, self._order = code, "="

    def build(self, state: Any) -> None:
        if state[1] not in ("<", ">", "|", "="):
            raise ValueError(f"a byte order {_shown(state[1])}")
        self._order = state[1]

    def read(self, data: object, count: int) -> npt.NDArray[Any]:
        dtype = np.dtype(self._order + self._code)
        if not isinstance(data, (bytes, bytearray)) or len(data) != count * dtype.itemsize:
            raise ValueError(f"an array of {count} numbers of {dtype}, with other data")
        return np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))


class _Array:
    """A NumPy array, while it is built."""

    value: npt.NDArray[Any]

    def build(self, state: Any) -> None:
        _, shape, dtype, by_columns, data = state
        self.fill(shape, dtype, by_columns is True, data)

    def fill(self, shape: Any, dtype: Any, by_columns: bool, data: Any) -> None:
        is_shape = len(_as(tuple, shape)) <= _MOST_AXES and all(type(n) is int and 0 <= n < 2**63 for n in shape)
        if not isinstance(dtype, _Type) or not is_shape:
            raise ValueError("an array without a type or a shape")
        self.value = dtype.read(data, math.prod(shape)).reshape(shape, order="F" if by_columns else "C")


class _Machine:
    """Executes a pickle's instructions (https://docs.python.org/3/library/pickletools.html)."""

    def __init__(self) -> None:
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}

    def run(self, data: bytes) -> object:
        for opcode, argument, place in pickletools.genops(data):
            if opcode.name == "STOP":
                return self._stack.pop()
            if not (self._value(opcode.name, argument) or self._call(opcode.name, argument)):
                raise ValueError(f"instruction {opcode.name} at byte {place}")
        raise ValueError("truncated")

    def _value(self, name: str, argument: Any) -> bool:
        """Executes an instruction that pushes values, lists and tuples, or uses the memo; False for others."""
        stack = self._stack
        if name in _LITERALS:
            stack.append(argument)
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name in _TUPLES:
            stack.append(tuple(self._take(len(stack) - _TUPLES[name])))
        elif name in ("BINPUT", "LONG_BINPUT"):
            self._memo[argument] = stack[-1]
        elif name == "MEMOIZE":
            self._memo[len(self._memo)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(self._memo[argument])
        elif name == "MARK":
            self._marks.append(len(stack))
        elif name == "TUPLE":
            stack.append(tuple(self._take(self._marks.pop())))
        elif name == "EMPTY_LIST":
            stack.append([])
        elif name in ("APPEND", "APPENDS"):
            items = self._take(len(stack) - 1 if name == "APPEND" else self._marks.pop())
            _as(list, stack[-1]).extend(items)
        else:
            return name in ("PROTO", "FRAME")
        return True

    def _call(self, name: str, argument: Any) -> bool:
        """Executes an instruction that names or calls a function, or sets an object's state; False for others."""
        stack = self._stack
        if name == "GLOBAL":
            stack.append(_named(argument))
        elif name == "STACK_GLOBAL":
            stack.append(_named(" ".join(self._take(len(stack) - 2))))
        elif name == "REDUCE":
            function, arguments = self._take(len(stack) - 2)
            stack.append(_called(_as(_Name, function), _as(tuple, arguments)))
        elif name == "BUILD":
            thing, state = self._take(len(stack) - 2)
            thing.build(_as(tuple, state))
            stack.append(thing)
        else:
            return False
        return True

    def _take(self, start: int) -> list[Any]:
        if not 0 <= start <= len(self._stack):
            raise ValueError("an instruction without its arguments")
        items = self._stack[start:]
        del self._stack[start:]
        return items


def _named(name: str) -> _Name:
    if name not in _NAMES:
        raise ValueError(f"it asks for {name!r}")
    return _Name(_NAMES[name])


def _called(function: _Name, arguments: tuple[Any, ...]) -> object:
    if function == "_reconstruct":  # an empty array: BUILD sets its state later
        return _Array()
    if function == "_frombuffer":  # the same in one step, since protocol 5
        data, dtype, shape, order = arguments
        array = _Array()
        array.fill(shape, dtype, order == "F", data)
        return array
    if function == "dtype":
        return _Type(arguments[0])
    if function == "scalar":
        return _as(_Type, arguments[0]).read(arguments[1], 1)[0]
    if function == "encode" and arguments[1] == "latin1":  # how protocol 2 writes bytes
        return _as(str, arguments[0]).encode("latin1")
    raise ValueError(f"a call of {function} with {', '.join(map(_shown, arguments[:5]))}")


def _shown(value: object) -> str:
    """Text for messages. For lists and tuples only the type: they may contain each other without end."""
    return repr(value)[:100] if isinstance(value, (str, int)) else type(value).__name__


def _as(kind: type, value: Any) -> Any:
    if not isinstance(value, kind):
        raise ValueError(f"a {type(value).__name__} in the place of a {kind.__name__.strip('_').lower()}")
    return value


def _plain(value: object) -> object:
    return value.value if isinstance(value, _Array) else value


def _checked(item: object) -> object:
    if not isinstance(item, (np.ndarray, np.generic, bool, int, float, bytes)):
        raise ValueError(f"an item of type {type(item).__name__}")
    return item

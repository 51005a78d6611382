# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The kernels that the build has compiled: calls of their library, without numba.

The library is one file of machine code. It holds the hash of the sources from which it was made, and for each kernel
the types of its arguments. A kernel receives a table of 64-bit words: of an array its address and shape, and its
strides where the kernel takes any; of a tuple the words of its elements, of a number the number itself.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import struct
from functools import partial
from itertools import chain
from operator import index, itemgetter, setitem
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import numpy as np

from posor.errors import SystemRefusal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Kernel = TypeVar("Kernel", bound="Callable[..., Any]")

PACKAGE = Path(__file__).parent.parent
FILE_NAME = "posor_kernels.so"
KERNEL_FILES = (
    "kernel_*.py",
    *(f"{folder}/[!.#]*.py" for folder in ("numerics", "model", "estimation", "chain", "messages")),
)
"""Files of the package that hold kernels and the constants that they are compiled with, and that build the library; no
locks of editors."""
MANIFEST = "posor_kernels_manifest"  # symbol: JSON with the fields "sources" and "kernels"
IN_TURN = "posor_kernels_in_turn"  # symbol: runs kernels one after the other, see ``run_in_turn``
RESULTS = 8  # words for the results of a kernel
NEW_BUILD = "a new build, such as 'make setup' or 'colcon build'"


def hash_of_sources() -> str:
    """Return a hash of the text of all files with kernels."""
    digest = hashlib.sha256()
    for file in sorted(file for pattern in KERNEL_FILES for file in PACKAGE.glob(pattern)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def describe_dtype(dtype: np.dtype[Any]) -> str:
    """Return a text that is the same for dtypes of one layout in memory only."""
    base, shape = dtype.subdtype or (dtype, ())
    if base.fields is None:
        text = base.str
    else:
        fields = sorted((offset, name, describe_dtype(field)) for name, (field, offset, *_) in base.fields.items())
        text = (
            "{" + ", ".join(f"{name} at {offset}: {field}" for offset, name, field in fields) + f"}} of {base.itemsize}"
        )
    return f"{text}{list(shape) or ''}"


def find_library() -> KernelLibrary | None:
    """Return the library beside the package or, of a package linked to its sources, in its build folder.

    Raises SystemRefusal: it was built from other sources.
    """
    for folder in (PACKAGE, PACKAGE.parent):
        if (file := folder / FILE_NAME).is_file():
            return KernelLibrary(file)
    return None


class KernelLibrary:
    """The library of one file."""

    def __init__(self, file: Path) -> None:
        """Load the file. Raises SystemRefusal: it was built from other sources, or is invalid."""
        try:
            self._code = ctypes.PyDLL(str(file))  # holds the interpreter's lock: releasing it costs more than a scan
            self._code_without_lock = ctypes.CDLL(str(file))
            manifest = json.loads(ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(self._code, MANIFEST))))
        except (OSError, ValueError) as error:
            raise SystemRefusal(f"cannot be loaded, {error}", where=str(file), expected=NEW_BUILD) from None
        if manifest["sources"] != hash_of_sources():
            raise SystemRefusal("was built from other sources", where=str(file), expected=NEW_BUILD)
        self._kernels: dict[str, dict[str, Any]] = manifest["kernels"]

    def kernel(self, function: Kernel) -> Kernel:
        """Return the kernel of the library that was made from a function; one that it does not have stays Python."""
        entry = self._kernels.get(f"{function.__module__}.{function.__name__}")
        if entry is None:
            return function
        code = self._code if entry["keeps_lock"] else self._code_without_lock
        return cast("Kernel", LibraryKernel(function, code, entry))

    def run_in_turn(self, kernels: Sequence[BoundKernel]) -> Callable[[], None]:
        """Return a function that runs kernels of this library, which have a ``call``, one after the other."""
        words = (ctypes.c_int64 * (3 * len(kernels)))(*chain.from_iterable(each.call or () for each in kernels))
        run, at, count = self._code[IN_TURN], ctypes.addressof(words), len(kernels)
        run.restype, run.argtypes = None, (ctypes.c_void_p, ctypes.c_int64)

        def call() -> None:
            run(at, count)

        call.memory = words, kernels  # type: ignore[attr-defined]  # the words have their addresses
        return call


class BoundKernel(NamedTuple):
    """A kernel with its arguments but for the last ones, integers: ``put`` them, ``run`` it, read the ``results``."""

    put: Callable[[tuple[int, ...]], object]
    run: Callable[[], object]
    results: Callable[[], Any]
    call: tuple[int, int, int] | None = None  # addresses of code, table and results; None: the kernel runs in Python
    memory: tuple[Any, ...] = ()  # what has the addresses in the table


class _Packed(NamedTuple):
    """A tuple of arrays and its words; as long as it is kept, no other tuple has its identity."""

    elements: tuple[Any, ...]
    words: list[int]
    kept: list[Any]


MOST_PACKED, MOST_BYTES = 256, 2**20  # tuples that are kept, and bytes of the arrays of each
_PACKED: dict[tuple[int, int], _Packed] = {}


def _bytes_of(element: Any) -> int:
    """Return the bytes of all arrays of a tuple."""
    return sum(map(_bytes_of, element)) if isinstance(element, tuple) else int(getattr(element, "nbytes", 0))


class LibraryKernel:
    """A kernel of the library; it takes the arguments of the function of which it was made."""

    def __init__(self, function: Callable[..., Any], code: ctypes.CDLL, entry: dict[str, Any]) -> None:
        self.__name__, self.__doc__ = function.__name__, function.__doc__
        self._code = code[entry["symbol"]]
        self._code.restype, self._code.argtypes = None, (ctypes.c_void_p, ctypes.c_void_p)
        self._types: list[Any] = entry["arguments"]
        self._results: str = entry["results"]
        self._known: set[tuple[str, np.dtype[Any]]] = set()

    def __call__(self, *arguments: Any) -> Any:
        """Run the kernel. Raises TypeError: an argument is not of the type that the kernel was compiled for."""
        if len(arguments) != len(self._types):
            self._refuse(f"{len(arguments)} arguments", f"{len(self._types)}")
        return self.bind(arguments)()

    def bind(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """Return a function of the remaining arguments, integers. Raises TypeError: see ``__call__``."""
        bound, missing = self.bind_in_parts(arguments), len(self._types) - len(arguments)
        put, run, results = bound.put, bound.run, bound.results

        def call(*integers: int) -> Any:
            if len(integers) != missing:
                self._refuse(f"{len(integers)} further arguments", f"{missing}")
            put(integers)
            run()
            return results()

        call.memory = bound.memory  # type: ignore[attr-defined]
        return call

    def bind_in_parts(self, arguments: tuple[Any, ...]) -> BoundKernel:
        """Return the kernel with its first arguments. Raises TypeError: see ``__call__``."""
        words: list[int] = []
        kept: list[Any] = []
        bound, others = self._types[: len(arguments)], self._types[len(arguments) :]
        if others != ["i"] * len(others):
            self._refuse(f"the first {len(arguments)} arguments", "all but integers")
        for argument, expected in zip(arguments, bound, strict=True):
            self._append(words, kept, argument, expected)
        begin, missing = len(words), len(others)
        table = (ctypes.c_int64 * (begin + missing))(*words)
        out = (ctypes.c_int64 * RESULTS)()
        at, to = ctypes.addressof(table), ctypes.addressof(out)
        put = partial(setitem, table, slice(begin, begin + missing))
        address = ctypes.cast(self._code, ctypes.c_void_p).value or 0
        memory = arguments, kept, table, out
        return BoundKernel(put, partial(self._code, at, to), self._reader(out), (address, at, to), memory)

    def _reader(self, out: ctypes.Array[ctypes.c_int64]) -> Callable[[], Any]:
        """Return a function that reads the results of the kernel."""
        kinds, floats = self._results, (ctypes.c_double * RESULTS).from_buffer(out)
        if kinds == "":
            return lambda: None
        if kinds == "b":
            return lambda: bool(out[0])
        return partial(itemgetter(*range(len(kinds))), floats if kinds == "f" else out)  # without a frame of Python

    def _append(self, words: list[int], kept: list[Any], argument: Any, expected: Any) -> None:
        """Append the words of an argument; ``kept``: objects that own the memory of words."""
        if expected == "i":
            words.append(int(argument) if isinstance(argument, np.bool_) else index(argument))
        elif expected == "f":
            words.append(struct.unpack("<q", struct.pack("<d", argument))[0])
        elif isinstance(expected, list):
            words.extend(self._words_of(argument, expected))
            kept.append(argument)
        else:
            # A record of an array shares the memory of the array.
            is_record = expected["dimensions"] is None
            array = np.frombuffer(argument, argument.dtype) if is_record else argument
            self._check(array, expected)
            kept.append(array)
            words.append(array.ctypes.data)
            words.extend(() if is_record else array.shape)
            words.extend(array.strides if expected["strided"] else ())

    def _words_of(self, elements: tuple[Any, ...], expected: list[Any]) -> list[int]:
        """Return the words of a tuple; those of small tuples are kept, because arrays do not move."""
        key = id(elements), id(expected)
        known = _PACKED.get(key)
        if known is not None:
            return known.words
        if len(elements) != len(expected):
            self._refuse(f"a tuple of {len(elements)}", f"of {len(expected)}")
        packed = _Packed(elements, [], [])
        for element, element_type in zip(elements, expected, strict=True):
            self._append(packed.words, packed.kept, element, element_type)
        if _bytes_of(elements) <= MOST_BYTES:
            if len(_PACKED) >= MOST_PACKED:
                _PACKED.clear()
            _PACKED[key] = packed
        return packed.words

    def _check(self, array: Any, expected: dict[str, Any]) -> None:
        """Raise TypeError: an array is not as the kernel expects, which would read and write other memory."""
        dimensions = expected["dimensions"]
        if dimensions is not None:
            if array.ndim != dimensions:
                self._refuse(f"an array of {array.ndim} dimensions", f"{dimensions}")
            if not (array.flags.c_contiguous or expected["strided"]):
                self._refuse("an array that is not contiguous", "one in C order")
            if not (array.flags.writeable or expected["read_only"]):
                self._refuse("a read-only array", "one that may be written")
        key = expected["dtype"], array.dtype
        if key not in self._known:
            if describe_dtype(array.dtype) != expected["dtype"]:
                self._refuse(f"an array of {array.dtype}", expected["dtype"])
            self._known.add(key)

    def _refuse(self, what: str, expected: str) -> None:
        message = f"kernel {self.__name__} received {what}; expected {expected}"
        raise TypeError(message)

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The error hierarchy of the POSOR stack.

Each error prints one sentence: what is wrong, where, and what is expected. Place (file, line, key) and offending value
are attributes as well, for callers.
"""

from __future__ import annotations

from contextlib import contextmanager
from copy import copy
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from posor.model.fault import Fault


class PosorError(Exception):
    """Base of every error that this stack raises on purpose.

    Attributes:
        what: What is wrong, a clause without a full stop.
        where: File, line, key, topic or parameter at fault; empty if the text names it.
        expected: What is expected; empty if it is obvious.
        summed: The single errors that this error sums up; empty: it is a single error.

    """

    exit_code = 1
    summed: tuple[PosorError, ...] = ()

    def __init__(self, what: str, *, where: str = "", expected: str = "") -> None:
        self.what = what
        self.where = where
        self.expected = expected
        sentence = f"{where}: {what}" if where else what
        if expected:
            sentence += f"; expected {expected}"
        super().__init__(sentence + ".")

    @property
    def parts(self) -> tuple[PosorError, ...]:
        """The single errors, each with its place: itself, or those that it sums up."""
        return self.summed or (self,)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the error with all attributes, for errors raised in worker processes."""
        return _unpickle, (type(self), str(self), self.__dict__)


def _unpickle(kind: type[PosorError], sentence: str, attributes: dict[str, Any]) -> PosorError:
    error = kind.__new__(kind, sentence)
    error.__dict__.update(attributes)
    return error


ErrorT = TypeVar("ErrorT", bound=PosorError)
ResultT = TypeVar("ResultT")


def sum_up(errors: Sequence[ErrorT]) -> ErrorT:
    """Return one error of a kind for several: the first with the number of further ones; one is returned as it is."""
    first, *others = errors
    if not others:
        return first
    summary = copy(first)
    PosorError.__init__(summary, f"{first.what} (and {len(others)} more)", where=first.where, expected=first.expected)
    summary.summed = tuple(errors)
    return summary


class SeveralErrors(PosorError):
    """Errors of several kinds, one sentence a line."""

    def __init__(self, errors: Sequence[PosorError]) -> None:
        super().__init__("\n".join(map(str, errors)).rstrip("."))
        self.summed = tuple(errors)
        self.exit_code = max(error.exit_code for error in errors)


class ErrorCollector:
    """Collects the errors of independent checks, so that all are reported at once.

    Attributes:
        errors: The single errors so far, each once.

    """

    def __init__(self) -> None:
        self.errors: list[PosorError] = []

    @contextmanager
    def collecting(self) -> Iterator[None]:
        """Collect a PosorError that ends the ``with`` block."""
        try:
            yield
        except PosorError as error:
            self.add(error)

    def result_of(self, call: Callable[[], ResultT]) -> ResultT | None:
        """Return the result of a function without arguments; None: its PosorError has been collected."""
        try:
            return call()
        except PosorError as error:
            self.add(error)
            return None

    def add(self, error: PosorError) -> None:
        """Add the parts of an error that are not known yet."""
        known = set(map(str, self.errors))
        self.errors += [part for part in error.parts if str(part) not in known]

    def raise_errors(self) -> None:
        """Raise what was collected. Raises PosorError: the only error, or SeveralErrors."""
        if self.errors:
            raise self.errors[0] if len(self.errors) == 1 else SeveralErrors(self.errors)


class ParameterError(PosorError):
    """A node parameter or command-line option is wrong.

    Attributes:
        parameter: Name of the node parameter at fault; empty for an option, or if several parameters are at fault.

    """

    exit_code = 2

    def __init__(self, what: str, *, where: str = "", expected: str = "", parameter: str = "") -> None:
        super().__init__(what, where=where, expected=expected)
        self.parameter = parameter


class CalibrationError(PosorError):
    """A calibration file cannot be read, or its content is invalid."""


class DataFileError(PosorError):
    """A recorded table cannot be read: missing file, missing column, or a cell that is not a number."""


class CertificateError(PosorError):
    """A Digital Calibration Certificate, or its schema, is invalid."""


class BagError(PosorError):
    """A rosbag2 bag cannot be read or written."""


class OutputError(PosorError):
    """Results cannot be written to their destination."""


class TopicError(PosorError):
    """A topic has an unexpected type or publisher, or a message on it cannot be decoded."""


class NodeError(PosorError):
    """A node has failed: the sentence of the error, the node's name, and its place in a file."""

    def __init__(self, error: PosorError, node: str, place: str = "") -> None:
        name = "" if node in str(error) else f"node {node}"
        super().__init__(str(error).rstrip("."), where=", ".join(filter(None, (place, name))))
        self.exit_code = error.exit_code


class SystemRefusal(PosorError):
    """The operating system refuses a request of the process: a priority, processors, memory."""


class ChainError(PosorError):
    """The kinematic chain (URDF, frames) does not match the POSORs that should measure it."""


class ScanError(PosorError):
    """The readings of a scan do not match the calibration: wrong count, not finite, no light.

    Attributes:
        fault: The flag of ``posor_msgs/JointTransform`` that reports it.

    """

    def __init__(self, what: str, *, fault: Fault, where: str = "", expected: str = "") -> None:
        super().__init__(what, where=where, expected=expected)
        self.fault = fault


class FitError(PosorError):
    """Data do not determine the fitted parameters, or contradict the model."""


class DesignError(PosorError):
    """No layout, or no allotment, meets a requirement; ``expected`` is the nearest requirement that can be met."""


class TrackError(PosorError):
    """A reference measurement cannot be used: no values, decreasing stamps, wrong unit or type."""


class ShapeError(PosorError, ValueError):
    """An array has the wrong shape."""

    def __init__(self, field: str, *, received: tuple[int, ...], expected: str, where: str = "") -> None:
        super().__init__(f"{field} has shape {received}", where=where, expected=expected)


def similar_name(name: str, names: Iterable[str], otherwise: str, *, least: float = 0.6) -> str:
    """Return what an unknown name may have meant, for ``expected`` of an error.

    ``name``: the unknown name. ``names``: the known names. ``otherwise``: the result if no known name is similar.
    ``least``: similarity that is required, 0 to 1, as ``difflib`` measures it.
    """
    similar = get_close_matches(name, list(names), n=1, cutoff=least)
    return f"perhaps '{similar[0]}'" if similar else otherwise


def clause_of(error: Exception) -> str:
    """Return the text of a library's error as a clause in one line, without a full stop; its type if it has no text."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def checked_path(path: object, where: str, expected: str) -> Path:
    """Return an argument of a public function as a path; raise ParameterError if it cannot be one."""
    if not isinstance(path, str | Path):
        raise ParameterError(f"{path!r} is of type {type(path).__name__}", where=where, expected=expected)
    if "\0" in str(path):
        raise ParameterError(f"{str(path)!r} contains a null character", where=where, expected=expected)
    return Path(path)


def check_type(value: object, kind: type, where: str) -> None:
    """Raise ParameterError if an argument of a public function is not of a type."""
    if not isinstance(value, kind):
        raise ParameterError(f"an argument is of type {type(value).__name__}", where=where, expected=kind.__name__)


def check_probability(value: object, where: str, *, or_zero: bool = False) -> None:
    """Raise ParameterError if an argument is not a probability between 0 and 1; ``or_zero``: zero is valid, too."""
    number = isinstance(value, int | float) and isfinite(value) and value < 1.0
    if not (number and (value > 0.0 or (or_zero and value == 0.0))):  # type: ignore[operator]
        expected = "a probability from 0 to below 1" if or_zero else "between 0 and 1"
        text = f"{value:g}" if isinstance(value, int | float) else repr(value)
        raise ParameterError(text, where=where, expected=expected)

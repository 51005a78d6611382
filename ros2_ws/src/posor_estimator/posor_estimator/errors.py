"""The one error hierarchy of the POSOR stack.

Every error prints one sentence that says what is wrong, where, and what would be right. The place (file, line, key)
and the offending value are also kept as attributes, so that a caller can act on them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posor_estimator.core.fault import Fault


class PosorError(Exception):
    """Base of every error that this stack raises on purpose.

    Attributes:
        what: What is wrong, a clause without a full stop.
        where: File, line, key, topic or parameter at fault; empty when the text already names it.
        expected: What would be right; empty when it is obvious.

    """

    exit_code = 1

    def __init__(self, what: str, *, where: str = "", expected: str = "") -> None:
        self.what = what
        self.where = where
        self.expected = expected
        sentence = f"{where}: {what}" if where else what
        if expected:
            sentence += f"; expected {expected}"
        super().__init__(sentence + ".")

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to another process whole: what is raised there is raised here."""
        return _received, (type(self), str(self), self.__dict__)


def _received(kind: type[PosorError], sentence: str, attributes: dict[str, Any]) -> PosorError:
    error = kind.__new__(kind, sentence)
    error.__dict__.update(attributes)
    return error


class ParameterError(PosorError):
    """A node parameter or command-line option is wrong.

    Attributes:
        parameter: Name of the node's parameter at fault; empty where it is none, or not one alone.

    """

    exit_code = 2

    def __init__(self, what: str, *, where: str = "", expected: str = "", parameter: str = "") -> None:
        super().__init__(what, where=where, expected=expected)
        self.parameter = parameter


class CalibrationError(PosorError):
    """A calibration file cannot be read, or says something that cannot be."""


class DataFileError(PosorError):
    """A recorded table cannot be read: missing file, column, or a cell that is not a number."""


class BagError(PosorError):
    """A rosbag2 bag cannot be read or written."""


class OutputError(PosorError):
    """Results cannot be written where they should go."""


class TopicError(PosorError):
    """A topic is not what a node takes it for, or a message on it cannot be read."""


class NodeError(PosorError):
    """A node has failed; its sentence, which node it is, and where a file asks for it."""

    def __init__(self, error: PosorError, node: str, place: str = "") -> None:
        named = "" if node in str(error) else f"node {node}"
        super().__init__(str(error).rstrip("."), where=", ".join(filter(None, (place, named))))
        self.exit_code = error.exit_code


class SystemRefusal(PosorError):
    """The operating system refuses what a process asks for: a priority, processors, memory."""


class ChainError(PosorError):
    """The kinematic chain (URDF, frames) does not fit the POSORs that should measure it."""


class ScanError(PosorError):
    """A scan's readings do not fit the calibration: wrong count, not finite, no light.

    Attributes:
        fault: The flag of ``posor_msgs/JointTransform`` that reports it.

    """

    def __init__(self, what: str, *, fault: Fault, where: str = "", expected: str = "") -> None:
        super().__init__(what, where=where, expected=expected)
        self.fault = fault


class FitError(PosorError):
    """Data do not determine what is to be fitted to them, or do not fit the model."""


class TrackError(PosorError):
    """A reference measurement cannot be used: no values, stamps that go back, the wrong unit or type."""

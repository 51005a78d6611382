"""Message types as they are installed: definition text, type hash, class, and messages as bytes.

Any type can be asked for: its ``.msg`` file and those of its parts are found through the ament index.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from posor_estimator.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

RAW_SCAN = "posor_msgs/msg/RawScan"
JOINT_TRANSFORM = "posor_msgs/msg/JointTransform"
POINT_STAMPED = "geometry_msgs/msg/PointStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"
VECTOR_STAMPED = "geometry_msgs/msg/Vector3Stamped"
JOINT_STATE = "sensor_msgs/msg/JointState"


class Definition(NamedTuple):
    """How a bag describes a message type."""

    text: str
    """Definition in ``ros2msg`` format, parts included."""
    type_hash: str
    """RIHS01 hash, which tells two versions of a type apart."""


class MessageTypes:
    """The installed message types that have been asked for so far."""

    def __init__(self) -> None:
        self._store = Typestore()

    def definition(self, name: str) -> Definition:
        """Return the definition of type ``name``, for instance ``std_msgs/msg/Header``.

        Raises:
            BagError: the type is not installed here.

        """
        self._register(name)
        text, _ = self._store.generate_msgdef(name, ros_version=2)
        return Definition(text, self._store.hash_rihs01(name))

    def new(self, name: str, /, **fields: Any) -> Any:
        """Return a message of type ``name``; every field must be given, number sequences as numpy arrays."""
        self._register(name)
        return self._store.types[name](**fields)

    def serialize(self, message: Any, name: str) -> bytes:
        """Return ``message`` as CDR; unlike that of the middleware, padding is always zero."""
        return bytes(self._store.serialize_cdr(message, name))

    def _register(self, name: str) -> None:
        if name in self._store.types:
            return
        types = get_types_from_msg(_definition_file(name).read_text(encoding="utf-8"), name)
        self._store.register(types)
        for _, fields in types.values():
            for _, descriptor in fields:
                for part in _parts(descriptor):
                    self._register(part)


def _parts(descriptor: Any) -> Iterator[str]:
    """Yield the message types that a field's type refers to."""
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        yield detail
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _parts(detail[0])


def _definition_file(name: str) -> Path:
    package, folder, leaf = ([*name.split("/"), "", ""])[:3]
    try:
        path = Path(get_package_share_directory(package)) / folder / f"{leaf}.msg"
    except (PackageNotFoundError, ValueError):
        raise BagError(f"message type {name} is unknown", expected=f"an installed package '{package}'") from None
    if not path.is_file():
        raise BagError(f"message type {name} is unknown", expected=f"a message that package '{package}' defines")
    return path


def message_class(name: str) -> Any:
    """Return the rclpy class of message type ``name``.

    Raises:
        BagError: the type has no Python class here.

    """
    package, _, leaf = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), leaf)
    except (ImportError, AttributeError):
        raise BagError(f"message type {name} has no Python class", expected=f"package '{package}', built") from None

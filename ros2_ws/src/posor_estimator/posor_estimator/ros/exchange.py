"""Who is at either end of a topic within one process (one rclpy context): see ``wire``."""

from __future__ import annotations

from threading import RLock
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from posor_estimator.errors import TopicError

if TYPE_CHECKING:
    from rclpy.context import Context

    from posor_estimator.ros.wire import Inlet, Outlet


class Exchange:
    """Knows the outlets and inlets of one context, and connects them whenever one comes or goes."""

    def __init__(self) -> None:
        """Know none."""
        self._outlets: dict[str, tuple[Outlet, ...]] = {}
        self._inlets: dict[str, tuple[Inlet, ...]] = {}
        self._lock = RLock()

    def check(self, end: Outlet | Inlet) -> None:
        """Look whether an end fits to those that are known.

        Raises:
            TopicError: Its topic is known by another type.

        """
        with self._lock:
            ends: tuple[tuple[Outlet | Inlet, ...], ...] = (
                self._outlets.get(end.topic_name, ()),
                self._inlets.get(end.topic_name, ()),
            )
        known = [other.message_type for others in ends for other in others]
        if known and known[0] is not end.message_type:
            raise TopicError(
                f"is of type {_type_name(end.message_type)} here",
                where=f"topic {end.topic_name}",
                expected=f"{_type_name(known[0])}, as another node of this process has it",
            )

    def add_outlet(self, outlet: Outlet) -> None:
        """Connect an outlet with the inlets of its topic."""
        with self._lock:
            self._outlets[outlet.topic_name] = (*self._outlets.get(outlet.topic_name, ()), outlet)
            self._connect(outlet.topic_name)

    def remove_outlet(self, outlet: Outlet) -> None:
        """Forget an outlet; its inlets then have another, or none."""
        with self._lock:
            left = tuple(other for other in self._outlets.get(outlet.topic_name, ()) if other is not outlet)
            self._outlets[outlet.topic_name] = left
            self._connect(outlet.topic_name)
            outlet.connect(())

    def add_inlet(self, inlet: Inlet) -> None:
        """Connect an inlet with the outlets of its topic."""
        with self._lock:
            self._inlets[inlet.topic_name] = (*self._inlets.get(inlet.topic_name, ()), inlet)
            self._connect(inlet.topic_name)

    def remove_inlet(self, inlet: Inlet) -> None:
        """Forget an inlet."""
        with self._lock:
            left = tuple(other for other in self._inlets.get(inlet.topic_name, ()) if other is not inlet)
            self._inlets[inlet.topic_name] = left
            self._connect(inlet.topic_name)

    def _connect(self, topic: str) -> None:
        outlets, inlets = self._outlets.get(topic, ()), self._inlets.get(topic, ())
        for inlet in inlets:
            inlet.listen(over_dds=not outlets)
        for outlet in outlets:
            outlet.connect(inlets)


_exchanges: WeakKeyDictionary[Context, Exchange] = WeakKeyDictionary()
_exchanges_lock = RLock()


def exchange_of(context: Context) -> Exchange:
    """Return that of a context."""
    with _exchanges_lock:
        return _exchanges.setdefault(context, Exchange())


def _type_name(message_type: type[Any]) -> str:
    """Return the ROS name of a message class, for instance ``posor_msgs/msg/RawScan``."""
    package, kind, *_ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"

"""Messages with stamps, as tests of nodes make and read them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_estimator.testing.graph import values_of

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticStatus

    from posor_estimator.testing.graph import Graph


def stamp(message: Any, seconds: int) -> Any:
    """Return the message with a stamp a quarter of a second after ``seconds``."""
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, 250_000_000
    return message


def seconds_of(messages: list[Any]) -> list[int]:
    """Return the whole seconds of the messages' stamps."""
    return [message.header.stamp.sec for message in messages]


def status_with(graph: Graph, name: str, key: str, text: str) -> DiagnosticStatus:
    """Return the newest status of that name once its value ``key`` contains ``text``."""

    def there() -> bool:
        latest = graph.latest(name)
        return latest is not None and text in values_of(latest).get(key, "")

    graph.wait_until(there, f"'{text}' in {key} of {name}")
    return graph.latest(name)

"""Quality of service as a bag keeps it, and as a recorder should ask for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rclpy.duration import Duration

INFINITE_NS = 2**63 - 1


def kept_in_bag(profile: QoSProfile) -> Qos:
    """Return an offered profile in the form that a bag's metadata have."""
    return Qos(
        history=QosHistory(int(profile.history)),
        depth=profile.depth,
        reliability=QosReliability(int(profile.reliability)),
        durability=QosDurability(int(profile.durability)),
        deadline=_time(profile.deadline),
        lifespan=_time(profile.lifespan),
        liveliness=QosLiveliness(int(profile.liveliness)),
        liveliness_lease_duration=_time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def _time(duration: Duration) -> QosTime:
    """Return a duration; unspecified (zero) and infinite ones are the same, and kept as infinite."""
    sec, nsec = divmod(duration.nanoseconds or INFINITE_NS, 1_000_000_000)
    return QosTime(sec, nsec)


def request_for(offers: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """Return the strictest profile that every offer satisfies.

    Reliable where all publishers are, or messages would be lost without need; best effort where one is, or its
    messages would not come at all. Latched (transient local) in the same way.
    """
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a cell of many arms, computed from those of one arm."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.reporting.report_table import ReportTable
from posor.ros_names import ENDPOINT_STATE_TOPIC, ENDPOINT_TOPIC, RAW_TOPIC, TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FRAME = 38  # Ethernet: preamble, header, checksum and gap [bytes]
IP, MTU = 20, 1500  # IPv4 header; largest IP packet [bytes]
MESSAGE = 8 + 20 + 12 + 24  # headers of UDP and RTPS, the time and the head of the data [bytes]
GIGABIT = 125e6  # bytes per second
DAY, YEAR = 86_400.0, 365.25 * 86_400.0
OFFSETS = {"NTP, 1 ms": 1e-3, "PTP with software stamps, 10 µs": 1e-5, "PTP with hardware stamps, 0.1 µs": 1e-7}
"""Typical differences of two clocks [s]."""
OTHERS = "all others: diagnostics, log, events"
LEAST_PER_SCAN = 0.1  # messages per scan of a topic that has about one for each scan
SUMS = ("topics", "bytes", "per_s", "wire_per_s")
SPLITS = {
    "an arm on one host, endpoint to a controller": (ENDPOINT_TOPIC, ENDPOINT_STATE_TOPIC),
    "drivers at the arm, all else elsewhere": (RAW_TOPIC,),
    "posor_node at the arm, chain_node elsewhere": (TRANSFORM_TOPIC,),
    "an arm on one host, raw scans recorded elsewhere": (RAW_TOPIC, ENDPOINT_TOPIC, ENDPOINT_STATE_TOPIC),
}
"""Topics that leave the host of an arm."""


def wire_bytes(size: float) -> float:
    """Return the bytes of a message of ``size`` bytes on Ethernet, with all headers and fragments of IP."""
    datagram = size + MESSAGE
    return datagram + math.ceil(datagram / (MTU - IP)) * (IP + FRAME)


def kinds_of_topics(arm: Mapping[str, Any], rate: float) -> dict[str, dict[str, float]]:
    """Return ``topics``, ``bytes``, ``per_s`` and ``wire_per_s`` [bytes/s] of each kind of topic of an arm.

    Rates are those at ``rate`` scans per second: a busy host misses ticks. Topics with less than a tenth of the
    rate of the scans, such as the diagnostics, are one kind, with their measured rate.
    """
    kinds: dict[str, dict[str, float]] = {}
    for topic, measured in arm["topics"].items():
        name = topic.removeprefix(f"/{arm['name']}/")
        name = name.rpartition("/")[2] if name.endswith((f"/{RAW_TOPIC}", f"/{TRANSFORM_TOPIC}")) else name
        per_scan = measured["per_s"] / arm["ticks_per_s"]
        name, per_s = (name, rate * per_scan) if per_scan >= LEAST_PER_SCAN else (OTHERS, measured["per_s"])
        kind = kinds.setdefault(name, dict.fromkeys(SUMS, 0.0))
        found = (1.0, measured["bytes"], per_s, per_s * wire_bytes(measured["bytes"]))
        for key, value in zip(SUMS, found, strict=True):
            kind[key] = max(kind[key], value) if key == "bytes" else kind[key] + value
    return dict(sorted(kinds.items(), key=lambda item: -item[1]["wire_per_s"]))


def scaling_tables(results: Mapping[str, Any]) -> dict[str, ReportTable]:
    """Return the tables by name."""
    cell, arm, cluster = (results[key] for key in ("cell", "arm", "cluster"))
    kinds = kinds_of_topics(arm, cell["rate"])
    return {
        "messages": _messages(kinds),
        "processor": _processor(cell, arm),
        "bandwidth": _bandwidth(cell, kinds),
        "discovery": _discovery(cell, arm),
        "clock": _clock(cell),
        "cluster": _cluster(cluster),
        "years": _years(cell, cluster),
    }


def _messages(kinds: Mapping[str, Mapping[str, float]]) -> ReportTable:
    rows = [
        (
            kind,
            f"{each['topics']:.0f}",
            f"{each['bytes']:,.0f}",
            f"{each['per_s']:,.0f}",
            f"{1e-6 * each['wire_per_s']:.2f}",
        )
        for kind, each in kinds.items()
    ]
    total = [sum(each[key] for each in kinds.values()) for key in ("topics", "per_s", "wire_per_s")]
    rows.append(("all", f"{total[0]:.0f}", "", f"{total[1]:,.0f}", f"{1e-6 * total[2]:.2f}"))
    header = ("topic", "topics", "bytes of a message, at most", "messages/s", "MB/s on Ethernet")
    return ReportTable("Messages of one arm, all recorded", header, rows)


def _processor(cell: Mapping[str, Any], arm: Mapping[str, Any]) -> ReportTable:
    rows = []
    for text, tick_s in (("endpoint received", arm["tick_s_received"]), ("all topics recorded", arm["tick_s"])):
        cores = cell["rate"] * tick_s
        arms = math.floor(cell["share"] * cell["cores"] / cores)
        hosts = f"{math.ceil(cell['arms'] / arms)}" if arms else "more cores needed"
        rows.append((text, f"{1e6 * tick_s:.0f}", f"{cores:.2f}", f"{arms}", hosts))
    header = ("processes beside the arm", "us per tick", "cores per arm", "arms per host", "hosts of the cell")
    title = f"Processor time; hosts of {cell['cores']} cores, used to {100 * cell['share']:.0f} %"
    return ReportTable(title, header, rows)


def _bandwidth(cell: Mapping[str, Any], kinds: Mapping[str, Mapping[str, float]]) -> ReportTable:
    rows = []
    for split, topics in SPLITS.items():
        wire, messages = (sum(kinds[topic][key] for topic in topics) for key in ("wire_per_s", "per_s"))
        rows.append(
            (
                split,
                f"{1e-6 * wire:.2f}",
                f"{cell['arms'] * messages:,.0f}",
                f"{100 * cell['arms'] * wire / GIGABIT:.1f}",
            )
        )
    header = ("split", "MB/s per arm", "messages/s of the cell", "% of 1 Gbit/s")
    return ReportTable("What leaves the hosts of the arms", header, rows)


def _discovery(cell: Mapping[str, Any], arm: Mapping[str, Any]) -> ReportTable:
    arms, processes = cell["arms"], arm["participants"]
    participants, endpoints = arms * processes, arms * arm["endpoints"]
    ways = {
        "one domain": (participants * (participants - 1), endpoints * (participants - 1)),
        "a domain for each arm": (arms * processes * (processes - 1), endpoints * (processes - 1)),
        "one domain with a discovery server": (2 * participants, endpoints),
    }
    rows = [(way, f"{pairs:,}", f"{announced:,}") for way, (pairs, announced) in ways.items()]
    title = f"Discovery of {participants} participants with {arm['endpoints']} writers and readers each"
    return ReportTable(title, ("way", "connections", "announcements at a start of the cell"), rows)


def _clock(cell: Mapping[str, Any]) -> ReportTable:
    rows = [(way, f"{1e6 * cell['speed'] * offset:,.1f}") for way, offset in OFFSETS.items()]
    return ReportTable("Clocks of two hosts", ("difference", f"error at {cell['speed']:g} m/s, um"), rows)


def _cluster(cluster: Mapping[str, Any]) -> ReportTable:
    size = cluster["bag_bytes"]
    rows = [
        (
            workers,
            f"{1e-6 * size / run['wall_s']:.1f}",
            f"{cluster['bag_seconds'] / run['wall_s']:.0f}",
            f"{1e12 * run['cpu_s'] / size / 3600.0:.1f}",
        )
        for workers, run in cluster["runs"].items()
    ]
    header = ("Dask workers", "MB/s of raw scans", "seconds of an arm per second", "core hours per TB")
    return ReportTable("Reprocessing on a cluster on this host", header, rows)


def _years(cell: Mapping[str, Any], cluster: Mapping[str, Any]) -> ReportTable:
    workers, run = max(cluster["runs"].items(), key=lambda item: int(item[0]))
    size, price = cluster["bag_bytes"], cell["price"]
    tb_year = 1e-12 * YEAR * cell["arms"] * size / cluster["bag_seconds"]
    hours = 1e12 * run["cpu_s"] / size / 3600.0
    wall_days = 1e12 * tb_year * run["wall_s"] * int(workers) / size / DAY
    figures: Sequence[tuple[str, str]] = (
        ("raw scans of one arm and day, GB", f"{1e-9 * DAY * size / cluster['bag_seconds']:.0f}"),
        (f"raw scans of {cell['arms']} arms and a year, TB", f"{tb_year:.0f}"),
        ("results, share of the raw scans", f"{cluster['result_bytes'] / size:.2f}"),
        (f"cost of a TB at {price:g} per core hour", f"{hours * price:.2f}"),
        ("cost of the year", f"{hours * price * tb_year:.0f}"),
        ("worker days of the year", f"{wall_days:,.0f}"),
    )
    return ReportTable("Years of bags, all hours recorded", ("", "figure"), figures)

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Draw the packages as boxes on floors, and the imports between them as arrows: ``make rooms``.

An arrow leaves the importing package below, with the number of imports, and enters the imported one from above. It
passes the floors between them through gaps. Imports inside functions and for type checkers count.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from statistics import fmean

import grimp
from count_lines import PRODUCT, count_lines
from environment import THIS, exit_with

ROOMS = (  # lowest first; rooms of one line do not import each other
    ("posor",),
    ("posor_ros",),
    ("posor_drivers", "posor_estimator", "posor_calibration", "posor_design"),
    ("posor_bringup",),
    ("posor_lab",),
)
MESSAGES = "posor_msgs"
"""Generated from message files: the lowest room, which imports no other."""
PACKAGES = [room for rooms in ROOMS for room in rooms]
FLOORS = [*reversed(ROOMS), (MESSAGES,)]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
PICTURE = THIS.root / "docs" / "images" / "rooms.svg"
WIDTH, FLOOR_HEIGHT, BOX_HEIGHT, BOX_WIDTH, MARGIN = 1000, 125, 46, 150, 12
PORT_DISTANCE, GAP_DISTANCE, GAP = 34, 10, 90
"""Distances of arrows at a box and in a gap, and the width of the outer gaps [px]."""
ROOM_HUE = 80
PAGE = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" style="background: #fff">
<style>
text {{ font: 13px sans-serif; text-anchor: middle }}
.name {{ font-weight: bold }}
rect {{ fill: #f4f4ec; stroke: #444 }}
.arrow {{ fill: none; stroke-width: 1.4 }}
.number {{ font-size: 11px; stroke: #fff; stroke-width: 4; paint-order: stroke }}
</style>
{body}
</svg>
"""

Arrow = tuple[str, str]


def build_graph(*, for_type_checkers: bool) -> grimp.ImportGraph:
    """Return every import of our packages, also those inside functions."""
    return grimp.build_graph(
        *PACKAGES, include_external_packages=True, exclude_type_checking_imports=not for_type_checkers, cache_dir=None
    )


def room_of(module: str) -> str:
    """Return the package of a module."""
    return module.partition(".")[0]


def count_imports(graph: grimp.ImportGraph) -> Counter[Arrow]:
    """Return the number of imports between each two packages: importing, imported."""
    arrows: Counter[Arrow] = Counter()
    for module in graph.modules:
        if room_of(module) in PACKAGES:
            for imported in map(room_of, graph.find_modules_directly_imported_by(module)):
                if imported in {*PACKAGES, MESSAGES} - {room_of(module)}:
                    arrows[room_of(module), imported] += 1
    return arrows


def place_boxes(arrows: Counter[Arrow]) -> dict[str, tuple[float, float]]:
    """Return the left and the right edge of the box of each package [px]."""
    boxes = {}
    for rooms in FLOORS:
        for number, room in enumerate(rooms):
            centre = WIDTH * (number + 0.5) / len(rooms)
            ports = max(sum(arrow[end] == room for arrow in arrows) for end in (0, 1))
            half = max(BOX_WIDTH, PORT_DISTANCE * ports) / 2.0
            boxes[room] = centre - half, centre + half
    return boxes


def route_arrows(arrows: Counter[Arrow], boxes: dict[str, tuple[float, float]]) -> dict[Arrow, list[float]]:
    """Return the places of each arrow, one for each floor from its first to its last [px]."""
    routes: dict[Arrow, list[float]] = {}
    used: Counter[tuple[int, float]] = Counter()
    for arrow in sorted(arrows, key=lambda arrow: (FLOOR[arrow[1]] - FLOOR[arrow[0]], arrow)):
        (start, end), (first, last) = ([fmean(boxes[room]) for room in arrow], [FLOOR[room] for room in arrow])
        routes[arrow] = [start]
        for floor in range(first + 1, last):
            edges = [edge for room in FLOORS[floor] for edge in boxes[room]]
            gaps = [fmean(pair) for pair in pairwise([edges[0] - GAP, *edges, edges[-1] + GAP])][::2]
            straight = start + (end - start) * (floor - first) / (last - first)
            gap = min(gaps, key=lambda x: abs(x - straight) + PORT_DISTANCE * used[floor, x])
            used[floor, gap] += 1
            routes[arrow].append(gap)
        routes[arrow].append(end)
    return routes


def spread_arrows(routes: dict[Arrow, list[float]]) -> dict[Arrow, list[float]]:
    """Return the routes, side by side where they share a place, in the order of the places before and after."""
    shared = defaultdict(list)
    for arrow, route in routes.items():
        for step, x in enumerate(route):
            neighbours = fmean(route[max(step - 1, 0) : step] + route[step + 1 : step + 2])
            role = (step == 0, step == len(route) - 1)
            shared[FLOOR[arrow[0]] + step, x, role].append((neighbours, arrow, step))
    spread = {arrow: [*route] for arrow, route in routes.items()}
    for (_, x, role), users in shared.items():
        distance = PORT_DISTANCE if any(role) else GAP_DISTANCE
        for number, (_, arrow, step) in enumerate(sorted(users)):
            spread[arrow][step] = x + distance * (number - (len(users) - 1) / 2.0)
    return spread


def draw(arrows: Counter[Arrow]) -> str:
    """Return the picture as SVG. Arrows are vertical beside boxes and curves between floors."""
    boxes, lines, drawn = place_boxes(arrows), count_lines(), []
    for (importer, imported), (x, *others) in spread_arrows(route_arrows(arrows, boxes)).items():
        y = MARGIN + FLOOR_HEIGHT * FLOOR[importer]
        number = f'<text class="number" x="{x:.0f}" y="{y + BOX_HEIGHT + 14}">{arrows[importer, imported]}</text>'
        path = f"M{x:.0f} {y}"
        for before, after in pairwise([x, *others]):
            start, middle, y = y + BOX_HEIGHT, y + (FLOOR_HEIGHT + BOX_HEIGHT) // 2, y + FLOOR_HEIGHT
            path += f" V{start} C{before:.0f} {middle} {after:.0f} {middle} {after:.0f} {y}"
        colour = f"hsl({ROOM_HUE * list(FLOOR).index(importer)} 65% 35%)"
        title = f"<title>{importer} imports {imported}</title>"
        drawn.append(f'<path class="arrow" stroke="{colour}" d="{path} m-4 -8 4 8 4 -8">{title}</path>{number}')
    for room, (left, right) in boxes.items():
        x, y = (left + right) / 2.0, MARGIN + FLOOR_HEIGHT * FLOOR[room]
        count = lines["lab" if room == "posor_lab" else f"{PRODUCT}/{room}", "source"]
        drawn.append(f'<rect x="{left:.0f}" y="{y}" width="{right - left:.0f}" height="{BOX_HEIGHT}" rx="5"/>')
        drawn.append(f'<text class="name" x="{x:.0f}" y="{y + 20}">{room}</text>')
        drawn.append(f'<text x="{x:.0f}" y="{y + 37}">{count:,} lines</text>')
    height = MARGIN * 2 + FLOOR_HEIGHT * (len(FLOORS) - 1) + BOX_HEIGHT
    return PAGE.format(width=WIDTH, height=height, body="\n".join(drawn))


def main() -> int:
    """Write the picture."""
    PICTURE.write_text(draw(count_imports(build_graph(for_type_checkers=True))), encoding="utf-8")
    return 0


if __name__ == "__main__":
    exit_with("make rooms", main)

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The map of a statement: the poses in two views, coloured by the uncertainty of the position, as SVG."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_design.statement import Statement

COLOURS = ("#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725")  # viridis: dark is small
WIDTH, HEIGHT, MARGIN, GAP, LEGEND = 420.0, 300.0, 58.0, 30.0, 34.0
VIEWS = ((0, 1, "x [m]", "y [m]"), (0, 2, "x [m]", "z [m]"))  # from above, from the side


def draw_map(statement: Statement) -> str:
    """Return the map as SVG; a ring marks the worst pose."""
    places = np.array([each.T_base_endpoint.translation for each in statement.poses])
    sizes = 1e6 * np.array([each.largest for each in statement.poses])
    edges = np.linspace(sizes.min(), sizes.max(), len(COLOURS) + 1)
    classes = np.clip(np.searchsorted(edges, sizes, side="right") - 1, 0, len(COLOURS) - 1)
    worst = int(np.argmax(sizes))
    total = 2.0 * WIDTH + GAP
    size = f"{total:g} {HEIGHT + LEGEND:g}"
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" font-size="13" font-family="sans-serif">']
    parts.append(f'<rect width="{total:g}" height="{HEIGHT + LEGEND:g}" fill="#ffffff"/>')
    for number, (across, up, x_name, y_name) in enumerate(VIEWS):
        offset = number * (WIDTH + GAP)
        parts += _view(places[:, [across, up]], classes, worst, offset, (x_name, y_name))
    step = total / len(COLOURS)
    for n, colour in enumerate(COLOURS):
        left, top = n * step + 6.0, HEIGHT + 12.0
        parts.append(f'<rect x="{left:g}" y="{top:g}" width="12" height="12" fill="{colour}"/>')
        parts.append(f'<text x="{left + 16.0:g}" y="{top + 10.0:g}">{edges[n]:.3g} to {edges[n + 1]:.3g} µm</text>')
    return "\n".join([*parts, "</svg>"])


def _view(points: FloatArray, classes: IntArray, worst: int, offset: float, names: tuple[str, str]) -> list[str]:
    """Return one view: both axes have the same scale."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, extent = 0.5 * (low + high), np.maximum(high - low, 1e-3)
    inner = np.array([WIDTH - 2.0 * MARGIN, HEIGHT - 2.0 * MARGIN])
    scale = float((inner / extent).min())
    shown = np.column_stack(
        [offset + 0.5 * WIDTH + scale * (points[:, 0] - middle[0]), 0.5 * HEIGHT - scale * (points[:, 1] - middle[1])]
    )
    left, top = offset + MARGIN - 8.0, MARGIN - 8.0
    width, height = inner + 16.0
    parts = [f'<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}" fill="none" stroke="#888888"/>']
    half = 0.5 * inner / scale
    for n, anchor in ((-1, "start"), (1, "end")):
        x, y = offset + 0.5 * WIDTH + 0.5 * n * inner[0], 0.5 * HEIGHT - 0.5 * n * inner[1]
        parts.append(
            f'<text x="{x:g}" y="{top + height + 14.0:g}" text-anchor="{anchor}">{middle[0] + n * half[0]:.3g}</text>'
        )
        parts.append(f'<text x="{left - 4.0:g}" y="{y + 4.0:g}" text-anchor="end">{middle[1] + n * half[1]:.3g}</text>')
    parts.append(
        f'<text x="{offset + 0.5 * WIDTH:g}" y="{top + height + 14.0:g}" text-anchor="middle">{names[0]}</text>'
    )
    parts.append(f'<text x="{left:g}" y="{top - 6.0:g}">{names[1]}</text>')
    order = np.argsort(classes, kind="stable")  # the worst on top
    size = 4.0 if len(points) < 500 else 2.5  # noqa: PLR2004  smaller where many overlap
    parts += [
        f'<circle cx="{shown[n, 0]:.1f}" cy="{shown[n, 1]:.1f}" r="{size:g}" fill="{COLOURS[classes[n]]}"/>'
        for n in order
    ]
    x, y = shown[worst]
    parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="#d55e00" stroke-width="2.5"/>')
    return parts

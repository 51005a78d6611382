"""How every figure of a report looks: colours, frame, legend, and the picture made of it."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart by colour-blind readers; each curve also has a marker or line style of its own.
BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
LIGHT_BLUE = "#56B4E9"
GREY = "#333333"
MICRON = 1e-6
DPI = 110


def png(figure: Figure) -> bytes:
    """Return the figure as a picture (PNG), the same bytes every time."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=DPI, metadata={"Software": None})
    return picture.getvalue()


def tidy(axes: Axes) -> None:
    """Give axes a light grid behind the curves and no frame above and at the right."""
    axes.grid(visible=True, color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def unique_entries(all_axes: Iterable[Axes]) -> tuple[list[Artist], list[str]]:
    """Return the legend's entries of several axes, each once."""
    entries: dict[str, Artist] = {}
    for axes in all_axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    return list(entries.values()), list(entries)

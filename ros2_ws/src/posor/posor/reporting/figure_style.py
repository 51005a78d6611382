"""Colours of all plots, and the style of the pictures (PNG): axes, output."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Palette of Okabe and Ito, which colour-blind readers can distinguish; curves also differ in marker or line style.
BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
LIGHT_BLUE = "#56B4E9"
GREY = "#333333"
MICRON = 1e-6
DPI = 110


def to_png(figure: Figure) -> bytes:
    """Return the figure as PNG; equal figures give equal bytes."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=DPI, metadata={"Software": None})
    return picture.getvalue()


def style_axes(axes: Axes) -> None:
    """Draw a light grid behind the curves; hide the frame above and at the right."""
    axes.grid(visible=True, color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)

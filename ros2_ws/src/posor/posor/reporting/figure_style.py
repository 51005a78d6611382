# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Colours of all plots."""

from __future__ import annotations

# Palette of Okabe and Ito, which colour-blind readers can distinguish; curves also differ in marker or line style.
BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
LIGHT_BLUE = "#56B4E9"
GREY = "#333333"
MICRON = 1e-6

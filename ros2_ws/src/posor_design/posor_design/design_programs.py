# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of setup.cfg; each program is imported when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

budget = LazyProgram("budget", "posor_design.budget_command")
design = LazyProgram("design", "posor_design.design_command")

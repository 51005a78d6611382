# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of setup.cfg; each program is imported when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

posor_node = LazyProgram("posor_node", "posor_estimator.posor_node", is_live=True)
chain_node = LazyProgram("chain_node", "posor_estimator.chain_node", is_live=True)
correction_node = LazyProgram("correction_node", "posor_estimator.correction_node", is_live=True)
compose = LazyProgram("compose", "posor_estimator.compose_command", is_live=True)

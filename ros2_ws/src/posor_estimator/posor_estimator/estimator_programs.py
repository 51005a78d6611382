"""Entry points of setup.py; each program is imported when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

posor_node = LazyProgram("posor_node", "posor_estimator.posor_node")
chain_node = LazyProgram("chain_node", "posor_estimator.chain_node")
compose = LazyProgram("compose", "posor_estimator.compose_command")
budget = LazyProgram("budget", "posor_design.budget_command")
calibrate = LazyProgram("calibrate", "posor_calibration.calibrate_command")
reprocess = LazyProgram("reprocess", "posor.bags.reprocess_command")
design = LazyProgram("design", "posor_design.design_command")
recover = LazyProgram("recover", "posor.bags.recover_command")

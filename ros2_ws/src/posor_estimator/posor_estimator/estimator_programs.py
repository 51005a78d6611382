"""Entry points of setup.py; each program is imported when it is called."""

from __future__ import annotations

from posor_estimator.lazy_program import LazyProgram

posor_node = LazyProgram("posor_node", "posor_estimator.ros.posor_node")
chain_node = LazyProgram("chain_node", "posor_estimator.ros.chain_node")
compose = LazyProgram("compose", "posor_estimator.ros.compose_command")
budget = LazyProgram("budget", "posor_estimator.uncertainty.budget_command")
calibrate = LazyProgram("calibrate", "posor_estimator.bags.calibrate_command")
reprocess = LazyProgram("reprocess", "posor_estimator.bags.reprocess_command")
design = LazyProgram("design", "posor_estimator.design.design_command")
recover = LazyProgram("recover", "posor_estimator.bags.recover_command")

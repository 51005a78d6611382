"""The programs of this package, as setup.py names them: each is loaded when it is called."""

from __future__ import annotations

from posor_estimator.starting import Starter

posor_node = Starter("posor_node", "posor_estimator.posor_node")
chain_node = Starter("chain_node", "posor_estimator.chain_node")
compose = Starter("compose", "posor_estimator.ros.compose")
budget = Starter("budget", "posor_estimator.budget.command")
calibrate = Starter("calibrate", "posor_estimator.calibrate.command")
golden = Starter("golden", "posor_estimator.golden")
accuracy = Starter("accuracy", "posor_estimator.accuracy.report")
reprocess = Starter("reprocess", "posor_estimator.reprocess.command")
bench_core = Starter("bench_core", "posor_estimator.accuracy.bench_core")

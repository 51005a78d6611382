"""Entry points of setup.py; a LazyProgram loads its program when it is called."""

from __future__ import annotations

from posor_estimator.lazy_program import LazyProgram

accuracy = LazyProgram("accuracy", "posor_validation.accuracy.accuracy_command")
arm = LazyProgram("arm", "posor_validation.arm_study.arm_command")
arm_budget = LazyProgram("arm_budget", "posor_validation.arm_study.arm_budget_command")
bench = LazyProgram("bench", "posor_validation.benchmark.benchmark_command")
bench_core = LazyProgram("bench_core", "posor_validation.accuracy.core_benchmark")
budgets = LazyProgram("budgets", "posor_validation.thesis_budgets.thesis_budgets_command")
calibrate_demo = LazyProgram("calibrate_demo", "posor_validation.campaign.calibrate_demo_command")
demo = LazyProgram("demo", "posor_validation.replay_1985.demo_command")
faults = LazyProgram("faults", "posor_validation.faults.faults_command")
fuzz = LazyProgram("fuzz", "posor_validation.fuzz.fuzz_command")
golden = LazyProgram("golden", "posor_validation.accuracy.golden_command")
instruments_trials = LazyProgram("instruments_trials", "posor_validation.instruments.trials_command")
soak = LazyProgram("soak", "posor_validation.soak.soak_command")
thesis = LazyProgram("thesis", "posor_validation.thesis_table.thesis_table_command")
zero_drift_1985 = LazyProgram("zero_drift_1985", "posor_validation.replay_1985.zero_drift_command")

# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of setup.cfg; a LazyProgram loads its program when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

accuracy = LazyProgram("accuracy", "posor_lab.accuracy.accuracy_command")
arm = LazyProgram("arm", "posor_lab.arm_study.arm_command")
arm_budget = LazyProgram("arm_budget", "posor_lab.arm_study.arm_budget_command")
bags = LazyProgram("bags", "posor_lab.foreign_bags.bags_command")
bench = LazyProgram("bench", "posor_lab.benchmark.benchmark_command")
bench_core = LazyProgram("bench_core", "posor_lab.accuracy.core_benchmark")
budgets = LazyProgram("budgets", "posor_lab.thesis_budgets.thesis_budgets_command")
calibrate_demo = LazyProgram("calibrate_demo", "posor_lab.campaign.calibrate_demo_command")
calibration_truth = LazyProgram("calibration_truth", "posor_lab.arm_study.calibration_truth_command")
commissioning = LazyProgram("commissioning", "posor_lab.commissioning.commissioning_command")
correction = LazyProgram("correction", "posor_lab.correction.correction_command")
demo = LazyProgram("demo", "posor_lab.replay_1985.demo_command")
faults = LazyProgram("faults", "posor_lab.faults.faults_command")
fuzz = LazyProgram("fuzz", "posor_lab.fuzz.fuzz_command")
golden = LazyProgram("golden", "posor_lab.accuracy.golden_command")
health = LazyProgram("health", "posor_lab.health.health_study_command")
instruments_trials = LazyProgram("instruments_trials", "posor_lab.instruments.trials_command")
mutations = LazyProgram("mutations", "posor_lab.mutations.mutations_command")
scaling = LazyProgram("scaling", "posor_lab.benchmark.scaling_command")
prediction_truth = LazyProgram("prediction_truth", "posor_lab.arm_study.prediction_truth_command")
shop = LazyProgram("shop", "posor_lab.shop.shop_command")
soak = LazyProgram("soak", "posor_lab.soak.soak_command")
statement_truth = LazyProgram("statement_truth", "posor_lab.arm_study.statement_truth_command")
thesis = LazyProgram("thesis", "posor_lab.thesis_table.thesis_table_command")
vibration = LazyProgram("vibration", "posor_lab.vibration.vibration_command")
zero_drift_1985 = LazyProgram("zero_drift_1985", "posor_lab.replay_1985.zero_drift_command")

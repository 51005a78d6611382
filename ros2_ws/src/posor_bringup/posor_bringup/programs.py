"""The programs of this package, as setup.py names them: each is loaded when it is called."""

from __future__ import annotations

from posor_estimator.starting import Starter

arm = Starter("arm", "posor_bringup.arm")
arm_budget = Starter("arm_budget", "posor_bringup.arm_budget")
bringup = Starter("bringup", "posor_bringup.bringup")
budgets = Starter("budgets", "posor_bringup.budgets")
calibrate_demo = Starter("calibrate_demo", "posor_bringup.calibrate_demo")
demo = Starter("demo", "posor_bringup.demo")
zero_drift_1985 = Starter("zero_drift_1985", "posor_bringup.zero_drift_1985")

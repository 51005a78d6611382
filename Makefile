# POSOR for ROS 2. Every target sets the workspace up first; a set-up that is up to date costs a fraction of a second.

.DEFAULT_GOAL := help
.PHONY: help setup demo arm calibrate-demo test accuracy budgets bench bench-core data lint lock clean

BAG ?= ymo
CAL ?= printed
ARM ?= five_axis
CONTROLLER ?= examples/endpoint_controller/endpoint_controller.py
CAMPAIGNS ?= 6
POSOR ?= both
TESTS ?=
BENCH ?=

help:
	@echo "make demo [BAG=ymo|yzmo|zmo] [CAL=printed|section84]   replay a 1985 test through the nodes and compare"
	@echo "make arm [ARM=five_axis|path] [CONTROLLER=path]        run a simulated arm, close a loop on it, report its errors"
	@echo "make calibrate-demo [CAMPAIGNS=6] [POSOR=both]         calibrate simulated POSORs from bags, judge it by the truth"
	@echo "make test [TESTS='path ...']                           lint, type check and all tests (or only those of TESTS)"
	@echo "make accuracy                                          closure, consistency and fault detection of the estimator"
	@echo "make budgets                                           error budgets of the thesis, cell by cell from the model"
	@echo "make bench [BENCH='--quick ...']                       latency, losses and cost of the graph, beside their floor"
	@echo "make bench-core                                        speed of the estimator's core"
	@echo "make data                                              make bags and calibrations again from tables and designs"
	@echo "make lint                                              ruff and mypy only"
	@echo "make setup                                             virtual environment, ROS 2 Jazzy, colcon build"
	@echo "make lock                                              renew the exact versions in requirements/*.txt"
	@echo "make clean                                             remove all that the above have made"
	@echo "./run PACKAGE EXECUTABLE [--ros-args ...]              run one node, as 'ros2 run' does"
	@echo "PYTHON=/path/to/python3.12 with any of them chooses the Python (3.11 or 3.12)."

setup:
	@tools/python.sh tools/setup_workspace.py

demo:
	@./run posor_bringup demo --bag $(BAG) --calibration $(CAL)

arm:
	@./run posor_bringup arm --arm $(ARM) $(if $(CONTROLLER),--controller $(CONTROLLER))

calibrate-demo:
	@./run posor_bringup calibrate_demo --campaigns $(CAMPAIGNS) --posor $(POSOR)

test: lint
	@.venv/bin/python -E tools/run_tests.py $(TESTS)

accuracy:
	@./run posor_estimator accuracy --output build/accuracy.json

budgets:
	@./run posor_bringup budgets --output build/budgets.json

bench: setup
	@.venv/bin/python -E tools/in_workspace.py -m tests.benchmarks.bench $(BENCH)

bench-core:
	@./run posor_estimator bench_core --output build/bench_core.json

data: setup
	@.venv/bin/python -E tools/in_workspace.py data/slocum1985/make_calibrations.py
	@.venv/bin/python -E tools/in_workspace.py data/arms/make_arm_calibrations.py
	@.venv/bin/python -E tools/in_workspace.py bags/make_bags.py
	@.venv/bin/python -E tools/in_workspace.py bags/make_arm_bag.py

lint: setup
	@.venv/bin/python -I -m ruff check
	@.venv/bin/python -I -m ruff format --check
	@if [ -x .venv/bin/mypy ]; then .venv/bin/python -I -m mypy; \
	else echo "mypy: not run, since its verdict depends on the pinned numpy and this Jazzy brings its own"; fi

lock:
	@tools/python.sh tools/lock_requirements.py

clean:
	rm -rf .venv build ros2_ws/build ros2_ws/install ros2_ws/log .mypy_cache .ruff_cache .pytest_cache

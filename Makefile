# POSOR for ROS 2. Every target sets the workspace up first; this takes a fraction of a second if nothing has changed.

.DEFAULT_GOAL := help
.PHONY: help setup environment audit bounds demo arm calibrate-demo faults commissioning time mutations fuzz foreign-bags instruments shop soak health statement-truth calibration-truth prediction correction vibration test test-long test-noble coverage accuracy budgets thesis bench bench-core scaling data docs lint words lines rooms wheels lock clean

BAG ?= ymo
CAL ?= printed
ARM ?= five_axis
CONTROLLER ?= examples/endpoint_controller/endpoint_controller.py
CAMPAIGNS ?= 6
POSOR ?= both
TESTS ?=
BENCH ?=
FAULTS ?=
COMMISSIONING ?=
FORBIDDEN_WORDS := told|abreast|eights|taking_turns|Outlet|Inlet|places, ints, floats
WHEELS := posor posor_calibration posor_design
export DCC_SCHEMA  # folder of the schema files of DCC and D-SI, for tests that need them
IN_WORKSPACE := .venv/bin/python -E tools/in_workspace.py

help:
	@echo "make demo [BAG=ymo|yzmo|zmo] [CAL=printed|section84]   replay a 1985 test through the nodes and compare"
	@echo "make arm [ARM=five_axis|path] [CONTROLLER=path]        run a simulated arm, close a loop on it, report its errors"
	@echo "make arm SHARED=1                                      coverage of arms with errors common to all joints and beams"
	@echo "make calibrate-demo [CAMPAIGNS=6] [POSOR=both]         calibrate simulated POSORs from bags, compare with the truth"
	@echo "make faults [FAULTS='--quick ...']                     inject every fault, count wrong poses published as valid"
	@echo "make commissioning [COMMISSIONING='--arms 20 ...']     exchange plugs, signs and files, count what is found"
	@echo "make time                                              the rows of make faults on time: clocks, late scans, multiplexed channels"
	@echo "make mutations [MUTATIONS='--quick ...']               break the model on purpose, find the check that notices"
	@echo "make foreign-bags [BAGS='--bags 500 ...']              generate bags of other writers, count how each is read"
	@echo "make fuzz [FUZZ='--scans 10000 ...']                   damage messages and files, count wrong poses"
	@echo "make instruments [INSTRUMENTS='--trials TEXT ...']      try every kind of device against a server"
	@echo "make shop [SHOP='--arms 100']                          endpoint in a shop whose temperature changes by 10 K"
	@echo "make health [HEALTH='--years 10 ...']                    monthly health tests of arms: sound, a probe that creeps, a beam bumped"
	@echo "make statement-truth [STATEMENT='--draws 500 ...']     U of posor statement against drawn arms"
	@echo "make calibration-truth [CALIBRATION_TRUTH='--arms 20 ...']   whole arms calibrated with a simulated tracker, against the truth"
	@echo "make correction [CORRECTION='--robots 20 ...']         robots corrected by the measured endpoint, against the truth"
	@echo "make prediction [PREDICTION='--arms 10 ...']            endpoint between scans by encoders, against the truth"
	@echo "make vibration [VIBRATION='--arms 20 ...']           endpoint of an arm that vibrates, static and dynamic chain, against the truth"
	@echo "make soak [SOAK='--seconds 120 ...']                   run an arm for an hour, find losses and growth"
	@echo "make test [TESTS='path ...']                           linters and all tests, or only the tests of TESTS"
	@echo "make test DCC_SCHEMA=folder                            with the tests that need the schema files of DCC and D-SI"
	@echo "make test-long [TESTS='path ...']                      the tests that take long: many draws, whole campaigns, benchmarks"
	@echo "make test-noble [TESTS='path ...']                     tests with Python 3.12 and the libraries of Ubuntu 24.04"
	@echo "make lint                                              ruff, mypy and forbidden words"
	@echo "make coverage                                          covered lines of the numerical packages"
	@echo "make accuracy [DESIGN=folder]                          consistency of the estimator; with DESIGN, of a designed POSOR"
	@echo "make budgets                                           error budgets of the thesis, cell by cell from the model"
	@echo "make thesis                                            numbers and figures of the thesis beside the computed ones"
	@echo "make bench [BENCH='--quick ...']                       latency, lost ticks and cost of the graph, offline speed"
	@echo "make scaling [SCALING='--arms 12 ...']                  figures of a cell of many arms, from those of one arm and a small cluster"
	@echo "make bench-core                                        speed of the numerical core"
	@echo "make lines                                             lines of source, code, tests and documentation of each package"
	@echo "make rooms                                             draw the packages and the imports between them"
	@echo "make data                                              regenerate bags and calibrations from tables and designs"
	@echo "make docs                                              pages of parameters and calculators, and the site build/docs/index.html"
	@echo "make wheels                                            wheels of the packages without ROS in build/wheels"
	@echo "make setup                                             virtual environment, ROS 2 Jazzy, colcon build"
	@echo "make audit                                             known vulnerabilities of the pinned libraries; needs pypi.org"
	@echo "make bounds                                            lowest and newest versions of the libraries, tried; needs pypi.org"
	@echo "make lock                                              update the exact versions in requirements/*.txt"
	@echo "make clean                                             remove all results of the targets above"
	@echo "./run PACKAGE EXECUTABLE [--ros-args ...]              run one node, as 'ros2 run' does"
	@echo "PYTHON=/path/to/python3.12 with any target selects the Python (3.11 or 3.12)."

setup:
	@tools/python.sh tools/setup_workspace.py

environment:
	@tools/python.sh tools/setup_workspace.py --without-build

audit: setup
	@.venv/bin/python -E -s tools/audit_requirements.py

bounds: setup
	@$(IN_WORKSPACE) tools/try_bounds.py

demo:
	@./run posor_lab demo --bag $(BAG) --calibration $(CAL)

arm:
	@./run posor_lab arm --arm $(ARM) $(if $(SHARED),--shared-terms --coverage-only,$(if $(CONTROLLER),--controller $(CONTROLLER)))

calibrate-demo:
	@./run posor_lab calibrate_demo --campaigns $(CAMPAIGNS) --posor $(POSOR)

faults:
	@./run posor_lab faults $(FAULTS)

commissioning:
	@./run posor_lab commissioning $(COMMISSIONING)

time:
	@./run posor_lab faults --rows 'time:' --output build/time.json $(FAULTS)

mutations:
	@./run posor_lab mutations $(MUTATIONS)

foreign-bags:
	@./run posor_lab bags $(BAGS)

fuzz:
	@./run posor_lab fuzz $(FUZZ)

instruments:
	@./run posor_lab instruments_trials $(INSTRUMENTS)

soak:
	@./run posor_lab soak $(SOAK)

scaling:
	@./run posor_lab scaling $(SCALING)

shop:
	@./run posor_lab shop $(SHOP)

health:
	@./run posor_lab health $(HEALTH)

calibration-truth:
	@./run posor_lab calibration_truth $(CALIBRATION_TRUTH)

correction:
	@./run posor_lab correction $(CORRECTION)

prediction:
	@./run posor_lab prediction_truth $(PREDICTION)

vibration:
	@./run posor_lab vibration $(VIBRATION)

statement-truth:
	@./run posor_lab statement_truth $(STATEMENT)

test: environment  # tools/run_tests.py builds
	@.venv/bin/python -E tools/run_tests.py $(TESTS)

test-long: environment
	@.venv/bin/python -E tools/run_tests.py --long $(TESTS)

test-noble:
	@PYTHON=$(or $(PYTHON),python3.12) tools/python.sh tools/run_noble_tests.py $(TESTS)

coverage: setup
	@.venv/bin/python -E tools/measure_coverage.py

accuracy:
	@./run posor_lab accuracy $(if $(DESIGN),--design $(DESIGN)) --output build/accuracy.json

budgets:
	@./run posor_lab budgets --output build/budgets.json

thesis:
	@./run posor_lab thesis --output build/thesis.json

bench:
	@./run posor_lab bench $(BENCH)

bench-core:
	@./run posor_lab bench_core --output build/bench_core.json

data: setup
	@$(IN_WORKSPACE) data/slocum1985/make_calibrations.py
	@$(IN_WORKSPACE) data/arms/make_arm_calibrations.py
	@$(IN_WORKSPACE) bags/make_bags.py
	@$(IN_WORKSPACE) bags/make_arm_bag.py
	@$(IN_WORKSPACE) bags/make_view_bag.py

docs: setup
	@$(IN_WORKSPACE) tools/document_parameters.py
	@$(IN_WORKSPACE) tools/document_calculators.py
	@$(IN_WORKSPACE) tools/document_messages.py
	@$(IN_WORKSPACE) -m sphinx -q -W --keep-going -d build/docs/.doctrees docs build/docs
	@echo "build/docs/index.html"

wheels: setup
	@POSOR_KERNEL_LIBRARY=$(CURDIR)/ros2_ws/build/posor/posor_kernels.so $(IN_WORKSPACE) -m pip wheel --quiet --no-deps \
		--no-build-isolation --no-index --wheel-dir build/wheels $(addprefix ./ros2_ws/src/,$(WHEELS))

lint: environment
	@.venv/bin/python -I -m ruff check
	@.venv/bin/python -I -m ruff format --check
	@if [ -x .venv/bin/mypy ]; then .venv/bin/python -I -m mypy; \
	else echo "mypy: skipped, because its result depends on the pinned numpy and this Jazzy has another one"; fi
	@$(MAKE) --no-print-directory words

words:
	@! git grep -nE "\b($(FORBIDDEN_WORDS))\b" -- '*.py' '*.md' ':!CHANGELOG.md'

lines: setup
	@.venv/bin/python -E tools/count_lines.py

rooms: setup
	@$(IN_WORKSPACE) tools/draw_rooms.py

lock:
	@tools/python.sh tools/lock_requirements.py

clean:
	rm -rf .venv build ros2_ws/build ros2_ws/install ros2_ws/log .mypy_cache .ruff_cache .pytest_cache

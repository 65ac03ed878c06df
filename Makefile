# make demo    set everything up in .venv, then run the closed loop as a ROS 2 graph
# make test    the same set-up, then all checks and tests; ALL=1 also those whose inputs are what they were when they passed
# make test-fast  what a change most likely breaks, in a minute
# make coverage   lines that tests reach
# make explore tests with random examples for MINUTES=10
# make storm   graphs under random faults, without DDS, for MINUTES=10
# make site    the documentation as a site, with search, into results/site
# make pages   all tables and pictures that follow from runs, into results/pages, and those that docs quote (an hour)
# make wheel   wheels of the package, with compiled kernels inside, and of the messages, into dist
# make clean   remove .venv and what builds and tools have left; recordings stay
# PYTHON=python3.12 make demo   chooses the interpreter (3.10 to 3.13) for a new .venv
# make demo ROS=jazzy           chooses the distribution of ROS 2 (kilted, jazzy) for a new .venv

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# The distribution of ROS 2 that .venv holds, if any, by the name of its wheel: ros_kilted_rclpy-9.1.2.dist-info.
HELD := $(word 2,$(subst _, ,$(notdir $(wildcard $(VENV)/lib/python3*/site-packages/ros_*_rclpy-*))))
ROS ?= $(or $(HELD),kilted)
# Errors only. They are complete, compiler output included.
INSTALL := $(BIN)/python -m pip -qq --disable-pip-version-check --no-input install
# Threads of OpenBLAS gain nothing here and wait for each other where other work holds the cores (cli/main.py).
export OPENBLAS_NUM_THREADS ?= 1
# Python compiles a module when it is first imported, and keeps what it has made: tests start hundreds of processes.
export PIP_NO_COMPILE := 1
unexport PYTHONDONTWRITEBYTECODE
SAY := @printf '%s\n'

MESSAGES := msg_defs/CMakeLists.txt msg_defs/package.xml msg_defs/pyproject.toml \
    $(wildcard msg_defs/msg/*.msg msg_defs/srv/*.srv msg_defs/packaging/*)
# The messages' wheel in dist, if it is of these messages, this Python and this distribution of ROS 2.
TAG := $(shell $(PYTHON) -c 'import sys; print("cp%d%d" % sys.version_info[:2])' 2>/dev/null)
FITTING = $(if $(filter $(shell cat $(MESSAGES) | sha256sum | cut -c1-64),$(shell cat dist/messages.sha256 2>/dev/null)),\
    $(if $(filter $(ROS),$(lastword $(shell cat dist/messages.sha256 2>/dev/null))),\
        $(wildcard dist/facts_damping_msgs-*-$(TAG)-$(TAG)-*.whl)))
METADATA := setup.py setup.cfg package.xml reproduction/pyproject.toml
SOURCES := $(shell find facts_damping extensions -name '*.py')

APT := on Debian or Ubuntu: apt install
NEEDS_PYTHON := Python 3.10 to 3.13 is needed ($(APT) python3; or choose one: PYTHON=python3.12 make ...)

# A shell that has another ROS 2 sourced would lead this one's Python to the other's libraries.
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
endif

.DELETE_ON_ERROR:
.PHONY: demo test test-fast coverage lint explore storm site pages wheel setup test-setup prerequisites clean

demo: setup
	@$(BIN)/python -m facts_damping_views.demo

# A test more at once than there are processors: those with graphs mostly wait. mypy goes beside them, and tells at the
# end. Types are those of Kilted's rclpy: that of Jazzy has few.
TYPES := $(if $(filter kilted,$(ROS)),$(BIN)/mypy,true)
PYTEST := $(BIN)/python -m pytest -n $$(($$(nproc) + 1)) --dist loadgroup --no-loadscope-reorder
test: test-setup lint
	@$(TYPES) > $(VENV)/types.txt & types=$$!; \
	echo "$(PYTEST)"; $(PYTEST); status=$$?; \
	wait $$types || status=$$?; echo "$(TYPES)"; cat $(VENV)/types.txt; exit $$status

# What a change most likely breaks, in a minute (tests/fast.py).
test-fast: test-setup lint
	$(TYPES)
	$(PYTEST) --fast 25

# Lines of Python that tests reach; compiled functions are no Python when they run.
coverage: test-setup
	$(PYTEST) --cov --cov-report=term:skip-covered

lint:
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports --no-logo

# Random examples instead of the same ones, until a test fails or the minutes are over: what it prints then goes into the
# test as an example of its own. MINUTES=60 make explore
MINUTES ?= 10
explore: test-setup
	@until=$$(($$(date +%s) + 60 * $(MINUTES))); seed=$$(date +%s); \
	while [ $$(date +%s) -lt $$until ]; do \
	    echo "explore: seed $$seed"; \
	    $(BIN)/python -m pytest -q -x -n logical -m hypothesis --hypothesis-profile explore --hypothesis-seed $$seed || exit 1; \
	    seed=$$((seed + 1)); \
	done

# Ends with an error if a rule is broken; what breaks it is in results/storms. MINUTES=60 make storm SEED=5
SEED ?= 0
storm: test-setup
	$(BIN)/facts-damping storm --minutes $(MINUTES) --seed $(SEED)

site: test-setup
	$(BIN)/mkdocs build --strict

# What docs/images has in folders is from the folder of the same name; what takes long goes on where it was interrupted.
PAGES := results/pages
QUOTED := architectures delay_margin deployment_margin preset_margin jitter loss bursts asymmetric_signals asymmetric_devices monte_carlo \
    compensation prediction measurement measurement_margin jacobians portraits
pages: demo
	mkdir -p $(PAGES)/demo && cp results/demo/tie_power.png $(PAGES)/demo
	$(BIN)/facts-damping validate --out docs/validation.md
	for system in two_area smib; do \
	    $(BIN)/facts-damping sweep comparison --set system=$$system --check-step --out $(PAGES)/comparison_$$system || [ $$? = 3 ] || exit 1; \
	done
	$(BIN)/facts-damping margin two_area_small --pade 6 --time-domain --max-delay 0.42 --out $(PAGES)/margin
	rm -rf $(PAGES)/large
	$(BIN)/facts-damping run two_area_large --out $(PAGES)/large
	$(BIN)/facts-damping analyze $(PAGES)/large/recording --spwvd w12 --out $(PAGES)/large
	for study in $(QUOTED); do $(BIN)/facts-damping sweep $$study --out $(PAGES)/$$study || [ $$? = 3 ] || exit 1; done
	for campaign in do_no_harm wrong_control healthy growing; do \
	    $(BIN)/facts-damping campaign $$campaign --out $(PAGES)/$$campaign || [ $$? = 3 ] || exit 1; \
	done
	$(BIN)/python benchmarks/verdicts.py --out $(PAGES)/verdicts
	rm -rf $(PAGES)/score && $(BIN)/facts-damping score --out $(PAGES)/score
	$(BIN)/facts-damping reproduce --out $(PAGES)/reproduction
	$(BIN)/facts-damping reproduce --profile deployment --out $(PAGES)/deployment
	sed 's|](what_holds.png)|](images/deployment/what_holds.png)|' $(PAGES)/deployment/what_holds.md > docs/what_holds.md
	$(BIN)/python -m facts_damping_reproduction.cockpit_picture docs/images/cockpit/live.png
	$(BIN)/python -m facts_damping_reproduction.pdci.tuned $(PAGES)/pdci
	$(BIN)/python -m facts_damping_reproduction.pdci.pages $(PAGES)/pdci
	sed -E 's#\]\(([a-z]+\.(png|csv))\)#](images/pdci/\1)#g' $(PAGES)/pdci/pdci.md > docs/pdci.md
	$(BIN)/python -m facts_damping_reproduction.inverters.pages $(PAGES)/inverters
	$(BIN)/python -m facts_damping_reproduction.inverter_faults.pages $(PAGES)/inverters
	sed -E 's#\]\(([a-z]+\.(png|csv))\)#](images/inverters/\1)#g' $(PAGES)/inverters/inverters_results.md > docs/inverters_results.md
	$(BIN)/python -m facts_damping_reproduction.result_figures $(PAGES)
	cd docs/images && for made in */*; do cp ../../$(PAGES)/$$made $$made || exit 1; done

# Both are for this Python, this kind of processor and this distribution of ROS 2. `make demo` takes the messages' wheel
# where it fits, and then needs no compiler.
wheel: setup
	@$(BIN)/python -m facts_damping.nodes.base.warmup --ship
	@rm -rf dist build && mkdir dist
	@$(INSTALL:install=wheel) --no-deps --wheel-dir dist . ; status=$$?; rm -rf facts_damping/compiling/objects build; exit $$status
	@$(INSTALL:install=wheel) --no-build-isolation --no-deps --wheel-dir dist ./msg_defs
	@cat $(MESSAGES) | sha256sum > dist/messages.sha256 && echo "$(ROS)" >> dist/messages.sha256
	@ls dist/*.whl

# Kernels and messages are compiled side by side.
setup: prerequisites
	@$(MAKE) --no-print-directory -j2 $(VENV)/.warm $(VENV)/.messages

test-setup: prerequisites
	@$(MAKE) --no-print-directory -j3 $(VENV)/.warm $(VENV)/.tools $(VENV)/.programs $(VENV)/.cases

# One line for the first prerequisite that is missing: what it is and how to get it.
prerequisites:
	@missing() { echo "$$1" >&2; exit 1; }; \
	asks() { $(PYTHON) -c "$$1" >/dev/null 2>&1; }; \
	command -v $(PYTHON) >/dev/null || missing "$(PYTHON) is missing: $(NEEDS_PYTHON)"; \
	asks 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' || \
	    missing "$(PYTHON) is $$($(PYTHON) -V 2>&1): $(NEEDS_PYTHON)"; \
	[ "$$(uname -sm)" = "Linux x86_64" ] || \
	    missing "$$(uname -sm): the wheels of ROS 2 are for Linux x86_64 only (elsewhere: ROS 2 from apt, and colcon build)"; \
	asks 'import ensurepip, venv' || \
	    missing "the venv module of $(PYTHON) is missing ($(APT) python3-venv)"; \
	asks 'import os, sys, sysconfig; sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' || \
	    missing "the header Python.h of $(PYTHON) is missing ($(APT) python3-dev)"; \
	[ "$(FITTING)" ] || for compiler in gcc g++; do \
	    command -v $$compiler >/dev/null || missing "the compiler $$compiler is missing ($(APT) gcc g++)"; \
	done; \
	[ ! -x $(BIN)/python ] || [ "$(origin PYTHON)" = file ] || \
	    [ "$$($(BIN)/python -V)" = "$$($(PYTHON) -V)" ] || \
	    missing "$(VENV) holds $$($(BIN)/python -V), $(PYTHON) is $$($(PYTHON) -V): make clean first"; \
	[ "$(filter $(ROS),kilted jazzy)" ] || missing "ROS=$(ROS): there are wheels of kilted and jazzy"; \
	[ "$(ROS)" = "$(or $(HELD),$(ROS))" ] || missing "$(VENV) holds ROS 2 $(HELD), ROS=$(ROS) is asked for: make clean first"

# A stamp for each step that is done: it runs again only if what it depends on has changed.
$(VENV)/.python:
	$(SAY) "set-up: virtual environment $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@touch $(VENV)/COLCON_IGNORE $@

$(VENV)/.package: $(METADATA) $(VENV)/.python
	$(SAY) "set-up: libraries, wheels of ROS 2 $(ROS), facts_damping"
	@$(INSTALL) -e ".[ros-$(ROS),cockpit]" -e ./reproduction
	@touch $@

$(VENV)/.messages: $(MESSAGES) setup.py | $(VENV)/.package
	$(SAY) "set-up: messages ($(if $(FITTING),$(FITTING),compiled here))"
	@$(INSTALL) $(if $(FITTING),--no-deps --force-reinstall $(FITTING),--no-build-isolation ./msg_defs)
	@touch $@

$(VENV)/.warm: $(SOURCES) $(VENV)/.package
	$(SAY) "set-up: compiling the numerical kernels"
	@$(BIN)/python -m facts_damping.nodes.base.warmup
	@touch $@

$(VENV)/.tools: $(METADATA) $(VENV)/.messages
	$(SAY) "set-up: test tools"
	@$(INSTALL) -e ".[ros-$(ROS),test]" -e ./reproduction
	@touch $@

# The browser of tests/analysis/test_report.py, and the dissector of tests/streams/c37118/test_tshark.py: Debian's, where they
# may be installed. Elsewhere the tests are skipped. One after the other: apt-get lets no other run beside it.
$(VENV)/.programs: | $(VENV)/.python
	@for program in chromium tshark; do \
	    if ! command -v $$program >/dev/null && [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	        echo "set-up: $$program, by which tests look at what was made"; \
	        { apt-get update -qq && \
	          DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends $$program; } \
	            >/dev/null 2>&1 || echo "set-up: no $$program to be had; its tests are skipped"; \
	    fi; \
	done
	@touch $@

# The PSS/E cases inside ANDES's wheel, which are not part of this repository: GPL (tests/andes_cases.py).
$(VENV)/.cases: | $(VENV)/.python
	$(SAY) "set-up: PSS/E cases of ANDES"
	@$(INSTALL:install=download) --no-deps --dest $(VENV)/andes andes==2.0.0
	@$(BIN)/python -m zipfile -e $(VENV)/andes/andes-2.0.0-py3-none-any.whl $(VENV)/andes
	@touch $@

clean:
	rm -rf $(VENV) build install log *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find facts_damping extensions tests launch -name __pycache__ -prune -exec rm -rf {} +

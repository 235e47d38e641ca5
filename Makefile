# `make demo` and `make test` set up everything they need in .venv; nothing but Python 3.11 and make must be there.
PYTHON ?= python3
# Versions that were tested together; `make CONSTRAINTS= test` tries the newest ones.
CONSTRAINTS ?= constraints.txt
EXTRAS ?= mujoco,pybullet,dart,dev
BIN := .venv/bin
READY := .venv/.ready
HEADERS ?= build/board
C_PLANNER ?= build/c_planner
MUTATIONS ?= 20
SEED ?= 1
# The wheel of LCM holds its C library.
LCM = $$($(BIN)/python -c 'import lcm, pathlib; print(pathlib.Path(lcm.__file__).parents[1])')
# `imolo view` and `imolo export`: half a gigabyte that the demo does without.
VIEWERS := .venv/.viewers

.PHONY: help setup demo ode test test-slow docs mutations lint bench pages messages headers c-planner clean

help: ## List what can be made.
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 20

setup: $(READY) ## Set up everything in .venv.

demo: $(READY) ## Compare the three engines: learn, throw 20 balls, hit them.
	$(BIN)/imolo compare configs/mujoco.yaml configs/pybullet.yaml configs/dart.yaml --out results/demo --fresh

ode: $(READY) ## Add ODE, the paper's engine, from Debian's packages; no root needed.
	bash backends/imolo_backends/engines/get_ode $(BIN)/python

test: $(VIEWERS) ## Run the tests, the long matrices left out.
	$(BIN)/python -m pytest -m "not slow" -n auto

test-slow: $(VIEWERS) ## Run the long matrices.
	$(BIN)/python -m pytest -m slow -n auto

docs: $(VIEWERS) ## Build the site of docs/ to build/site; links, names and code blocks are checked.
	$(BIN)/python -m sphinx -W --keep-going -q -j auto -b html docs build/site

mutations: $(VIEWERS) ## Change the code at MUTATIONS random places (SEED) and see whether the tests notice.
	$(BIN)/python -m pip install --quiet 'cosmic-ray>=8.4' 'coverage>=7.10'
	$(BIN)/python tools/mutations.py $(MUTATIONS) --seed $(SEED)

lint: $(READY) ## Check style and types.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY) ## Measure speed; prints a table and writes benchmarks/results.json.
	$(BIN)/python -m benchmarks

pages: $(VIEWERS) ## Write the pictures and tables of README and docs from results/.
	$(BIN)/python tools/pages.py

messages: $(READY) ## Generate lcmtypes/imolo_msgs from lcmtypes/*.lcm.
	cd lcmtypes && ../$(BIN)/lcm-gen --python --ppath . *.lcm

headers: $(READY) ## Write C structs of the valve board's messages to build/board, for firmware.
	mkdir -p $(HEADERS)/lcm
	cd lcmtypes && $(abspath $(BIN))/lcm-gen --c --c-no-pubsub --c-cpath $(abspath $(HEADERS)) --c-hpath $(abspath $(HEADERS)) \
		board_*.lcm actuator_command_t.lcm
	cp $(LCM)/include/lcm/lcm_coretypes.h $(HEADERS)/lcm

c-planner: $(READY) ## Build examples/c_planner, a planner in C, to build/c_planner.
	mkdir -p $(C_PLANNER)
	cd lcmtypes && $(abspath $(BIN))/lcm-gen --c --c-cpath $(abspath $(C_PLANNER)) --c-hpath $(abspath $(C_PLANNER)) \
		actuator_command_t.lcm envelope_t.lcm heartbeat_t.lcm marker_t.lcm mocap_frame_t.lcm plan_t.lcm step_answer_t.lcm \
		step_request_t.lcm
	gcc -std=gnu11 -O2 -Wall -Wextra -I$(C_PLANNER) -I$(LCM)/include -o $(C_PLANNER)/planner \
		examples/c_planner/planner.c $(C_PLANNER)/*.c $(LCM)/lib/liblcm.a -l:libglib-2.0.so.0 -lm -lpthread

clean: ## Remove the environment and everything generated.
	rm -rf .venv build results .mypy_cache .pytest_cache .ruff_cache .hypothesis

$(READY): pyproject.toml $(CONSTRAINTS)
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable ".[$(EXTRAS)]"
	touch $(READY)

$(VIEWERS): $(READY)
	$(BIN)/python -m pip install --quiet $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable ".[$(EXTRAS),export,view]"
	touch $(VIEWERS)

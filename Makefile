# SPDX-License-Identifier: Apache-2.0
.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON ?= python3
export PYTHON

STAMPS := .venv/.stamps
RUN := . tools/env.sh &&
PACKAGES := irec_calibration irec_correction irec_sim
INTERFACES := $(wildcard irec_msgs/msg/*.msg irec_msgs/srv/*.srv irec_msgs/action/*.action) irec_msgs/CMakeLists.txt irec_msgs/package.xml
SETUPS := $(foreach p,$(PACKAGES),$(wildcard $(p)/setup.py $(p)/setup.cfg $(p)/package.xml $(p)/launch/*.launch.py))
CONFIG := $(wildcard config/*/) # a folder changes when a file is added; what is in the files is linked
LAUNCH := $(foreach p,$(PACKAGES),$(wildcard $(p)/launch/*.launch.py))

.PHONY: help build demo demo-hidden test lint bench bench-peers hidden clean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1|\2/' | column -t -s '|'

build: $(STAMPS)/workspace ## environment and workspace (done by the others when needed)

$(STAMPS)/environment: tools/setup_env.sh tools/requirements-ros.txt tools/requirements.txt tools/constraints.txt
	@bash tools/setup_env.sh .venv
	@mkdir -p $(STAMPS) && touch $@

$(STAMPS)/workspace: $(STAMPS)/environment tools/build.sh $(INTERFACES) $(SETUPS) $(CONFIG)
	@bash tools/build.sh
	@touch $@

demo: build ## calibrate the simulated AFP cell through the nodes and drive a course with correction
	@$(RUN) python tools/demo.py

demo-hidden: build ## a cell with an effect that the model lacks: find it, add it, watch the error fall
	@$(RUN) python tools/demo_hidden.py

test: build ## the whole suite
	@$(RUN) bash tools/test.sh

lint: build ## ruff, mypy, launch files
	@$(RUN) ruff check .
	@$(RUN) mypy $(foreach p,$(PACKAGES),$(p)/$(p))
	@$(RUN) python -c 'import sys; [compile(open(f).read(), f, "exec") for f in sys.argv[1:]]' $(LAUNCH)

bench: build ## how fast it is, beside plain ways of doing the same
	@$(RUN) for file in tools/bench/*.py; do echo "== $$file"; python "$$file" || exit 1; done

bench-peers: build ## irec beside FIGAROH on measured data (installs it into out/peers, needs the data)
	@$(RUN) python tools/peers/run.py

HIDDEN_SEED ?= 2026

hidden: build ## blind matrix of hidden effects: generate, diagnose and improve, score (about 20 min)
	@rm -rf out/hidden out/hidden-truth out/hidden-said
	@$(RUN) irec-sim hidden --out out/hidden --seed $(HIDDEN_SEED) \
	  && python tools/hidden/run.py out/hidden -o out/hidden-said \
	  && python tools/hidden/score.py out/hidden out/hidden-truth out/hidden-said

clean: ## remove the environment and everything that was built
	rm -rf .venv build install log out

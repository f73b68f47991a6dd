# SPDX-License-Identifier: Apache-2.0
.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON ?= python3
export PYTHON

STAMPS := .venv/.stamps
RUN := . tools/env.sh &&
PACKAGES := irec_calibration irec_correction irec_sim
INTERFACES := $(wildcard irec_msgs/msg/*.msg irec_msgs/srv/*.srv irec_msgs/action/*.action) irec_msgs/CMakeLists.txt irec_msgs/package.xml $(wildcard irec_msgs/irec_ros/*.py) $(wildcard tools/local_ros/tf2_msgs/* tools/local_ros/tf2_msgs/msg/*)
SETUPS := $(foreach p,$(PACKAGES),$(wildcard $(p)/setup.py $(p)/setup.cfg $(p)/package.xml $(p)/launch/*.launch.py))
CONFIG := $(wildcard config/*/) # a folder changes when a file is added; what is in the files is linked
LAUNCH := $(foreach p,$(PACKAGES),$(wildcard $(p)/launch/*.launch.py))

.PHONY: help build demo demo-hidden demo-year workbench docs pictures test test-long test-fast lint bench bench-peers fuzz faults endurance hidden clean

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

HIDDEN_SESSION ?= out/workbench/hidden-effect

$(HIDDEN_SESSION)/session.yaml: | $(STAMPS)/workspace
	@$(RUN) irec-sim session --truth config/truths/demo_hidden.yaml --poses 31 --seed 5 --name hidden-effect -o $(HIDDEN_SESSION)

workbench: build $(HIDDEN_SESSION)/session.yaml ## a web page on a session with a hidden effect: find it, try it, watch the error fall
	@$(RUN) irec workbench $(HIDDEN_SESSION) --cell config/cells/afp.yaml -o out/workbench

CASE_ARGS ?=
.PHONY: case-afp case-machining case-tables

case-afp: build ## the paper's first case study on a plant as hard as the real one, beside its Table 1 (8 to 10 min; CASE_ARGS=--every 4)
	@$(RUN) python tools/case.py afp $(CASE_ARGS)

case-machining: build ## the same for the second case study, roughing of a dome
	@$(RUN) python tools/case.py machining $(CASE_ARGS)

case-tables: build ## the tables of docs/case-studies.md, from both cases once they are done
	@$(RUN) python tools/case.py tables

demo-year: build ## three years of one robot: certificates, an ageing gear, a loosened base, roll back (about 8 min)
	@$(RUN) python tools/demo_year.py

docs: build ## the docs as a site in out/site, with a page for each effect
	@$(RUN) python -m mkdocs build --strict -q && echo "out/site/index.html"

pictures: build ## the pictures of README and docs, drawn anew (about a minute)
	@$(RUN) python tools/docs/pictures.py

test: build ## the suite
	@$(RUN) bash tools/test.sh

test-long: build ## runs of processes that take minutes each and are left out of `make test`
	@$(RUN) bash tools/test.sh -m long --timeout=900

test-fast: build ## the part without ROS and without long tests
	@$(RUN) python -m pytest -p no:cacheprovider -q -m "not ros and not slow" -n 2

lint: build ## ruff, mypy, launch files
	@$(RUN) ruff check .
	@$(RUN) mypy irec_msgs/irec_ros $(foreach p,$(PACKAGES),$(p)/$(p))
	@$(RUN) python -c 'import sys; [compile(open(f).read(), f, "exec") for f in sys.argv[1:]]' $(LAUNCH)

bench: build ## how fast it is, beside plain ways of doing the same
	@$(RUN) for file in tools/bench/*.py; do echo "== $$file"; python "$$file" || exit 1; done

bench-peers: build ## irec beside FIGAROH on measured data (installs it into out/peers, needs the data)
	@$(RUN) python tools/peers/run.py

FUZZ_SECONDS ?= 3600
FUZZ_SEED ?= $(shell date +%j)

fuzz: build ## mutated files against every reader for an hour: no trace, no hang, no gigabyte
	@$(RUN) python tools/fuzz/run.py --seconds $(FUZZ_SECONDS) --seed $(FUZZ_SEED)

FAULTS ?=

faults: build ## each fault at each phase of procedure and correction, with real processes (half an hour; goes on where it was stopped)
	@$(RUN) python tools/faults/fault_matrix.py --page docs/faults.md $(FAULTS)

ENDURANCE_SECONDS ?= 0

endurance: build ## 8 h of the correction and 24 h of the procedure, accelerated: what grows (hours; ENDURANCE_SECONDS bounds each)
	@$(RUN) python tools/endurance/correction.py --hours 8 --seconds $(ENDURANCE_SECONDS)
	@$(RUN) python tools/endurance/node.py
	@$(RUN) python tools/endurance/procedure.py --hours 24 --seconds $(ENDURANCE_SECONDS)

HIDDEN_SEED ?= 2026
HIDDEN_SIZE ?= 1

hidden: build ## blind matrix: generate, diagnose and improve, score (20-25 min; HIDDEN_SIZE=0.5, HIDDEN_ARGS=--quick)
	@rm -rf out/hidden out/hidden-truth out/hidden-said
	@$(RUN) irec-sim hidden --out out/hidden --seed $(HIDDEN_SEED) --size $(HIDDEN_SIZE) $(HIDDEN_ARGS) \
	  && python tools/hidden/run.py out/hidden -o out/hidden-said \
	  && python tools/hidden/score.py out/hidden-truth out/hidden-said

clean: ## remove the environment and everything that was built
	rm -rf .venv build install log out

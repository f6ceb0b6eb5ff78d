# make run, make test: everything else is made on the way. No compiler needed.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
UV = $(BIN)/uv
RIG ?= plants/atb1000/rigs/engage.yaml
PLANT ?= *
# of `make swarm`: today's
SEED ?= $(shell date +%Y%m%d)0000
# rigs of drives with a master, around which it draws too
DRIVES = tests/drivers/canopen/mastered.yaml,tests/drivers/robots/mit.yaml,tests/drivers/robots/moteus.yaml
# processes of `make test`, 1 GB each; two leave a fifth of two processors idle, as tests wait
WORKERS ?= 3
# what another Python or numpy can change: types, bits, machine code, processes
CHOICE = tests/golden tests/drivers tests/executive/batch tests/fuzz \
	$(addprefix tests/executive/nodes/test_,virtual.py first_sample.py) tests/contract/test_ways.py \
	$(addprefix tests/executive/loop/test_,intrusion.py supervisor_model.py) \
	tests/tools/run/test_run.py tests/tools/test_pytest_plugin.py tests/tools/api/test_api.py
# what reaches the loop and the bus; of the last also what takes long
COVERED = tests/executive/loop $(addprefix tests/executive/loop/rare_,cycles.py frames.py) \
	tests/drivers/canopen/test_drive_frames.py \
	$(addprefix tests/drivers/test_,bus.py choice.py e2e.py frame_bits.py plain_bus.py stuffing.py)
COVERED_DEEP = $(addprefix tests/drivers/test_,codec.py dbc.py dbc_entries.py wire.py) \
	$(addprefix tests/executive/loop/test_,injected_frames.py injected_values.py reset.py) \
	tests/executive/nodes/test_waits_end.py

PYTEST = $(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder
# uv takes a third of pip's time; it knows no mirror that pip is told of. Bytecode is made of what
# every command imports; of a tenth of the rest it is made by who imports it
BYTECODE = can llvmlite matplotlib mcap numba numpy yaml
PIP_INSTALL = $(BIN)/pip install --no-compile --disable-pip-version-check
INSTALLING = $(PYTHON) -P tools/dev/installing.py
define PIP
@mirror=$$($(BIN)/pip config list | grep '[.]index-url='); \
	[ -x $(UV) ] || $(PIP_INSTALL) -q --only-binary :all: uv >/dev/null 2>&1; \
	{ [ -z "$$mirror" ] && [ -x $(UV) ] && \
	$(INSTALLING) $(UV) pip install --python $(BIN)/python -e '.[$(EXTRAS)]'; } || \
	$(INSTALLING) $(PIP_INSTALL) --progress-bar off -e '.[$(EXTRAS)]'
@cd $(VENV)/lib/*/site-packages && $(abspath $(BIN))/python -m compileall -q -j 0 -x '/tests?/' \
	$(BYTECODE) >/dev/null 2>&1 || true
endef

.PHONY: run help test quick test-deep test-all test-choice test-pythons test-lowest test-locked lock test-quiet coverage install lint release swarm loop laws compiled size bless docs notebook reference test-vcan vcan-tools test-browser browser-tools firmware-tools clean tools

run: install ## the main job: a closed loop; picture, log and verdict in runs/
	$(BIN)/pcpc run $(RIG)

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "%-15s%s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

test quick test-deep test-choice: export PYTHONDONTWRITEBYTECODE = # hundreds of processes: none compiles Python again
test quick test-deep test-choice: export OPENBLAS_NUM_THREADS = 1# its threads spin where there is nothing for them
test: tools ## what each change needs; CHANGED=main: what that can reach
	$(MAKE) --no-print-directory -j2 compiled
	$(MAKE) --no-print-directory -j2 lint quick

quick: tools ## its tests alone, without types and style
	$(PYTEST) $(if $(CHANGED),--changed $(CHANGED))

test-deep: tools ## the other tests, 40 minutes; MINUTES=20: a part
	$(MAKE) --no-print-directory compiled
	$(PYTEST) --deep only $(if $(MINUTES),--minutes $(MINUTES))

test-all: test test-deep ## all tests that need no CAN in the kernel

test-choice: tools ## types and a choice of the tests, for another PYTHON
	$(MAKE) --no-print-directory -j2 compiled lint
	$(PYTEST) --deep no $(CHOICE)

test-pythons: tools ## test-choice with every other Python that is here
	$(BIN)/python .ci/pythons.py $(MAKE) --no-print-directory test-choice

test-lowest: tools ## test-choice with the lowest versions that pyproject.toml allows
	@$(UV) venv -q --clear --seed --python $(BIN)/python build/lowest
	@VIRTUAL_ENV=build/lowest $(UV) pip install -q --resolution lowest-direct -e '.[plot,test]'
	@touch build/lowest/installed build/lowest/tools
	$(MAKE) --no-print-directory VENV=build/lowest test-choice

test-locked: tools ## test-choice with the versions of uv.lock
	@$(UV) venv -q --clear --seed --python $(BIN)/python build/locked
	@UV_PROJECT_ENVIRONMENT=build/locked $(UV) sync -q --frozen --inexact --python $(BIN)/python --extra plot --extra test
	@touch build/locked/installed build/locked/tools
	$(MAKE) --no-print-directory VENV=build/locked test-choice

lock: tools ## uv.lock anew, with the newest versions that pyproject.toml allows
	$(UV) lock --upgrade

test-vcan: tools ## the tests on a real vcan0, in a virtual machine if need be
	bash tools/vcan_stage.sh

test-browser: tools ## the page of `pcpc host` in a real browser
	$(BIN)/pytest tests/browser -m browser

test-quiet: tools ## gates of timing, for a machine that does nothing else
	$(BIN)/pytest tests/quiet -m quiet

coverage: tools ## whether tests reach all of loop and bus, lines and branches; long
	@rm -rf build/coverage
	-NUMBA_DISABLE_JIT=1 $(BIN)/coverage run -m pytest --deep no $(COVERED) $(COVERED_DEEP)
	-NUMBA_DISABLE_JIT=1 $(BIN)/coverage run -m pytest --deep only $(COVERED_DEEP)
	@$(BIN)/coverage combine -q
	@$(BIN)/coverage report

install: $(VENV)/installed ## the virtual environment, with pcpc in it

$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed, $(PYTHON) is $$($(PYTHON) -V 2>&1); set PYTHON=..." >&2; exit 4; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "the venv module is missing; run: sudo apt-get install python3-venv" >&2; exit 4; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: EXTRAS = plot
$(VENV)/installed: pyproject.toml | $(VENV)/bin/pip
	$(PIP)
	touch $@

tools: $(VENV)/tools ## what tests, checks and documentation need beside it

$(VENV)/tools: EXTRAS = plot,test
$(VENV)/tools: pyproject.toml | $(VENV)/bin/pip
	$(PIP)
	touch $(VENV)/installed $@

$(VENV)/docs: EXTRAS = docs,plot
$(VENV)/docs: $(VENV)/installed
	$(PIP)
	touch $@

vcan-tools: ## packages for `pcpc vm` and the vcan tests; uses sudo
	$$([ $$(id -u) = 0 ] || echo sudo) apt-get update -qq
	$$([ $$(id -u) = 0 ] || echo sudo) apt-get install -y --no-install-recommends \
		qemu-system-x86 busybox-static zstd iproute2 can-utils

browser-tools: ## Chromium, Firefox and Node for the tests of pages; uses sudo
	$$([ $$(id -u) = 0 ] || echo sudo) apt-get update -qq
	$$([ $$(id -u) = 0 ] || echo sudo) apt-get install -y --no-install-recommends chromium firefox-esr nodejs

firmware-tools: ## compilers and QEMU for generated C; uses sudo
	$$([ $$(id -u) = 0 ] || echo sudo) apt-get update -qq
	$$([ $$(id -u) = 0 ] || echo sudo) apt-get install -y --no-install-recommends gcc libc6-dev \
		gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm \
		gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static

size: install ## tokens and lines of each room; SINCE=main: and what was added
	@$(BIN)/python tools/dev/size.py $(SINCE)

release: tools ## sdist and wheel in dist/, tried; WHEELS, TRY: others
	@$(BIN)/python tools/dev/release.py $(if $(TRY),--try $(TRY),$(WHEELS))

swarm: install ## five minutes of drawn rigs, with a new SEED each day
	@echo "pcpc swarm --seed $(SEED)"
	@$(BIN)/pcpc swarm --seed $(SEED) --for 4m
	@$(BIN)/pcpc swarm --seed $(SEED) --for 1m --rig $(DRIVES)

lint: tools ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

compiled: loop laws ## what several tests share, compiled once

loop: tools ## the loop in all its uses, compiled
	@$(BIN)/python tests/compile_all.py loop

laws: tools ## laws and lanes, compiled
	@$(BIN)/python tests/compile_all.py laws

bless: tools ## the golden runs (of PLANT) anew, after a change that is meant
	cd tests/golden && PYTHONPATH=$(CURDIR) $(CURDIR)/$(BIN)/python golden.py "$(PLANT)"

docs: $(VENV)/docs ## the documentation as a site, in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "open build/site/index.html"

notebook: tools ## docs/notebooks, run again
	$(BIN)/python docs/site/notebook.py

reference: tools ## docs/reference, from the parser and the docstrings
	$(BIN)/python docs/site/reference.py

clean: ## everything that can be made again, but not runs/
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

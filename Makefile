# Everything runs in a virtual environment of its own, .venv, made on first use.

# The first Python from 3.11 on that this machine has. To use another one: make PYTHON=python3.13
ifeq ($(origin PYTHON), undefined)
PYTHON := $(shell for python in python3 python3.13 python3.12 python3.11 python3.14; do \
    $$python -c "import sys; sys.exit(sys.version_info < (3, 11))" 2>/dev/null \
    && command -v $$python && break; done)
endif
VENV ?= .venv
BIN := $(VENV)/bin
REPORT ?= demo-report

# The versions and hashes of requirements/*.txt, and nothing else: see `make lock`.
# Python compiles a module when it is first imported: most of a gigabyte never is.
PIP = $(BIN)/python -m pip install --quiet --no-compile
LOCKED = $(PIP) --require-hashes --requirement
# Without build isolation: the build backend is locked, too.
LOCAL = $(PIP) --no-deps --no-build-isolation --no-index --editable

PARALLEL = $(BIN)/pytest --dist loadgroup --no-loadscope-reorder
# The files with tests that are judged by the clock, the longest first.
REALTIME = $$(grep -rl --include="test_*.py" "mark\.realtime" tests | sort -r)

.PHONY: demo quick test accuracy attack browser test-hardware test-service check style docs bench lock clean

## A simulated robot's tour of a room that is rearranged meanwhile; then a recording of a real robot,
## in lockstep: no computer is too slow for it.
demo: $(VENV)/ready
	$(BIN)/cairn up sim --overlay demo_tour --report $(REPORT)/tour
	$(BIN)/cairn up replay_mrclam --lockstep --seed 1 --report $(REPORT)/recording
	@echo "pictures: map.png and reliability.png in $(REPORT)/tour and $(REPORT)/recording"

## The tests without real processes, images and long runs: a good minute on two cores.
quick: $(VENV)/tests
	$(PARALLEL) -n 2 \
	    -m "not processes and not images and not realtime and not slow and not accuracy"

## The tests that judge a change: five to nine minutes on two cores. One worker more than cores: many
## tests wait for processes that they have started. Those that are judged by the clock run apart:
## mostly they wait, so that two at a time disturb no other.
test: $(VENV)/tests
	$(PARALLEL) -n 3 -m "not realtime and not accuracy"
	$(PARALLEL) -n 2 -m "realtime and not accuracy" $(REALTIME)

## What `make test` checks once, with more seeds, recordings, types and drivers, and what takes long:
## about 20 minutes.
accuracy: $(VENV)/tests
	$(PARALLEL) -n 3 -m "accuracy and not realtime"
	$(PARALLEL) -n 2 -m "accuracy and realtime" $(REALTIME)

## Hostile files, requests, messages and users against a simulated robot: minutes, on loopback only.
attack: $(VENV)/tests
	$(BIN)/pytest -n 2 --dist loadgroup tests/attack

## The console's page in Chromium (Debian's package `chromium`) with a simulated robot; its decoder in
## Node.js, against Foxglove's from npm. Pictures of the page are left in build/browser. What is
## missing on this machine is skipped, with the reason.
browser: $(VENV)/tests
	$(BIN)/pytest tests/browser

## The drivers on the kernel's own devices, in a virtual machine: cameras, USB and RS-232 lines whose
## plugs are pulled. Reports what is missing, and installs nothing unless CI=true.
test-hardware: $(VENV)/tests
	$(BIN)/python -m tests.hardware

## The systemd unit, in a virtual machine that systemd has booted: takes minutes.
test-service: $(VENV)/tests
	$(BIN)/python -m tests.hardware --booted

## Style, types, import contracts, documentation, and all tests.
check: $(VENV)/tests style docs
	$(MAKE) test

## Style, types and import contracts.
style: $(VENV)/tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/mypy

## The documentation site, in build/site: a broken link fails the build.
docs: $(VENV)/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

## All benchmarks.
bench: $(VENV)/ready
	$(BIN)/python -m cairn_lab.benchmarks

## Renew the lock files from the ranges of pyproject.toml: only what no longer fits, or everything
## with `make lock UPGRADE=--upgrade`. Then THIRD_PARTY.md, which states the versions.
LOCK = $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
    --no-emit-index-url --no-annotate --no-header $(UPGRADE)
lock: $(VENV)/ready
	$(LOCKED) requirements/lock.txt
	$(LOCK) pyproject.toml --extra all --group dev --group interop --output-file requirements/dev.txt
	$(LOCK) --group docs --constraint requirements/dev.txt --output-file requirements/docs.txt
	$(LOCK) --group lock --output-file requirements/lock.txt
	$(LOCK) --group pip --output-file requirements/pip.txt
	$(LOCKED) requirements/dev.txt
	$(BIN)/python -m tests.packaging.third_party

$(VENV)/ready: pyproject.toml lab/pyproject.toml requirements/dev.txt requirements/pip.txt
	@test -n "$(PYTHON)" || { echo "Cairn needs Python 3.11 or later, and none was found. Install one \
	(Ubuntu, Debian: apt-get install python3 python3-venv), or name it: make PYTHON=/path/to/python3" \
	>&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(LOCKED) requirements/pip.txt
	$(LOCKED) requirements/dev.txt
	$(LOCAL) . --editable lab
	@echo "compiling the kernels, so that no robot waits for it, nor each test worker"
	@$(BIN)/python -c "import sys; from cairn.deployment.plugins import installed_plugins; \
	    from cairn.system.kernel_compilation import compile_deferred, defer_compilation; \
	    defer_compilation(); installed_plugins(); sys.exit(not compile_deferred())"
	@touch $@

# The plugins that the tests run, some of them broken on purpose.
$(VENV)/tests: $(VENV)/ready tests/plugin_package/pyproject.toml
	$(LOCAL) tests/plugin_package
	@touch $@

$(VENV)/docs: $(VENV)/ready requirements/docs.txt
	$(LOCKED) requirements/docs.txt
	@touch $@

clean:
	rm -rf .venv .venv-* build *.egg-info $(REPORT)

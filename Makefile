# Everything runs in a virtual environment of its own, .venv, made on first use.
PYTHON ?= python3.11
BIN := .venv/bin
REPORT ?= demo-report

.PHONY: demo test test-hardware test-service check docs bench clean

## A simulated robot's tour of a room that is rearranged meanwhile; then a real robot's recording.
demo: .venv/ready
	$(BIN)/cairn up deploy/sim.yaml --overlay deploy/demo_tour.yaml --report $(REPORT)/tour
	$(BIN)/cairn up deploy/replay_mrclam.yaml --report $(REPORT)/recording
	@echo "pictures: map.png and reliability.png in $(REPORT)/tour and $(REPORT)/recording"

## All tests.
test: .venv/tests
	$(BIN)/pytest -n 2 --dist loadgroup --no-loadscope-reorder -m "not realtime"
	$(BIN)/pytest -m realtime

## The drivers on the kernel's own devices, in a virtual machine: cameras, USB and RS-232 lines whose
## plugs are pulled. Says what it lacks, and installs nothing unless CI=true.
test-hardware: .venv/tests
	$(BIN)/python -m tests.hardware

## The systemd unit, in a virtual machine that systemd has booted: takes minutes.
test-service: .venv/tests
	$(BIN)/python -m tests.hardware --booted

## Style, types, import contracts, and all tests.
check: .venv/tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MAKE) test

## The documentation site, in build/site: a broken link fails the build.
docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

## What is measured, against what.
bench: .venv/ready
	$(BIN)/python -m benchmarks

.venv/ready: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable . --group dev --group interop
	$(BIN)/cairn plugins >/dev/null  # compiles the kernels, so that no robot waits for it
	@touch $@

# The plugins that the tests run, some of them broken on purpose.
.venv/tests: .venv/ready tests/plugin_package/pyproject.toml
	$(BIN)/python -m pip install --quiet --editable tests/plugin_package
	@touch $@

.venv/docs: .venv/ready
	$(BIN)/python -m pip install --quiet --group docs
	@touch $@

clean:
	rm -rf .venv build *.egg-info $(REPORT)

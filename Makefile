# make demo    a virtual skin, the runtime and a subscriber, shown live (installs no torch)
# make test    lint, Python and C tests; four minutes on two cores
# make test-quick | test-all    without processes and heavy sums, under a minute; with mypy and all that is slow
# make check   the same, and mypy
# make coverage                            the lines of each file that the Python tests of `make test` run
# make docs    the documentation as HTML in .build/docs; a warning is an error
# make release-check                       the sdist and the wheel, as an index and a bare environment take them
# make test-arm                            what the runtime computes, as aarch64 under qemu-user; skipped without it
# make bench   the benchmarks, each as one JSON object
# make firmware | qemu                     the device's C for the emulated board; run it
# make powercut | fuzz | hotplug | soak    the device under fault, each with its figures as one JSON line last
# make attack                              everything at once, for long; how much was withstood, as one JSON line last
#
# Every target makes its own virtual environment. PYTHON names the interpreter to start from.

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check --quiet --retries 10 --timeout 60
PYTEST := $(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 --dist loadfile --durations 10

# Twice as many as there are cores: many tests wait for the processes that they have started.
export PYTEST_XDIST_AUTO_NUM_WORKERS ?= $(shell echo $$((2 * $$(nproc))))

# Keep bytecode even where the environment forbids it: a worker then collects the tests in 10 s of CPU, not in 22.
export PYTHONDONTWRITEBYTECODE :=

SECONDS_DEMO ?= 20
OTHER_PYTHONS ?= 3.11 3.12 3.13

.DEFAULT_GOAL := help
.PHONY: help demo docs test test-quick test-rest test-all check lint types unit slow wheel wheel-test release-check \
        wheel-test-others wheel-test-lowest wheel-test-newest firmware-test system-packages bench clean \
        firmware qemu powercut fuzz hotplug soak attack coverage test-arm

help:
	@sed -n '1,/^$$/s/^# \{0,1\}//p' Makefile

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; \
	    assert sys.version_info >= (3, 11), "eitskin needs Python 3.11 or newer, found " + sys.version'
	@$(PYTHON) -m venv $(VENV) || { tools/system-packages.sh python3-venv && $(PYTHON) -m venv --clear $(VENV); }

$(VENV)/.demo: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) install --constraint constraints.txt --editable '.[sim,record]'
	@touch $@

# torch by its pin alone and first: any other way of asking for it may bring gigabytes of CUDA.
$(VENV)/.dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) install torch==2.13.0
	$(PIP) install --constraint constraints.txt --editable '.[train,dev,cluster]'
	@touch $@ $(VENV)/.demo

# Every worker compiles what it imports, tests for 12 s of CPU: before the first run one process does it for all.
$(VENV)/.collected: $(VENV)/.dev
	@$(BIN)/python -m pytest --collect-only -q -m "not slow" >/dev/null || true
	@touch $@

# Other programs' files, which the slow tests alone read, and what runs a notebook, simulators and a bridge: 350 MB that
# nobody else needs.
$(VENV)/.slow: pyproject.toml constraints.txt | $(VENV)/.dev
	$(PIP) install --constraint constraints.txt --editable '.[train,dev,cluster,parquet,ros,notebook,simulators]' \
	    eclipse-zenoh
	@touch $@

# Beside the demonstration's packages, so that docstrings can be read; no torch.
$(VENV)/.docs: pyproject.toml constraints.txt | $(VENV)/.demo
	$(PIP) install --constraint constraints.txt --editable '.[sim,record,docs]'
	@touch $@

$(VENV)/.release: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) install --constraint constraints.txt --editable '.[release]'
	@touch $@

demo: $(VENV)/.demo
	$(BIN)/eitskin demo --seconds $(SECONDS_DEMO)

docs: $(VENV)/.docs
	@rm -rf .build/docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html -d .build/doctrees docs .build/docs
	@echo "open .build/docs/index.html"

# Side by side: many tests wait for the processes that they have started.
test: $(VENV)/.dev system-packages
	@$(MAKE) --no-print-directory --jobs --output-sync=line lint unit firmware-test

# The rest: what `make test` leaves out, so that both together are everything. All that pip installs comes first.
# Types and documents take one core for two minutes while slow tests wait.
test-rest: $(VENV)/.slow $(VENV)/.docs release-check
	@$(MAKE) --no-print-directory --jobs --output-sync=line types slow docs
	@$(MAKE) --no-print-directory wheel-test-others wheel-test-lowest wheel-test-newest

test-all: test test-rest

test-quick: $(VENV)/.dev
	$(PYTEST) -m "not slow and not process and not heavy"

# A first mypy takes a core for more than a minute, so `make test` leaves it to the rest.
check: $(VENV)/.dev system-packages
	@$(MAKE) --no-print-directory --jobs --output-sync=line lint types unit firmware-test

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev
	$(BIN)/mypy

unit: $(VENV)/.collected system-packages
	$(PYTEST) -m "not slow"

coverage: $(VENV)/.dev system-packages
	@rm -rf .build/coverage && mkdir -p .build/coverage
	$(BIN)/python -m coverage run -m pytest -m "not slow" --numprocesses auto --maxprocesses 8 --dist loadfile -q
	@$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report --skip-covered --sort cover

slow: $(VENV)/.dev $(VENV)/.slow system-packages
	@tools/system-packages.sh chromium
	$(PYTEST) -m slow

firmware-test: $(VENV)/.dev system-packages
	@if [ -f firmware_proto/Makefile ]; then $(MAKE) -C firmware_proto check PYTHON=$(abspath $(BIN)/python); fi

system-packages:
	@tools/system-packages.sh

# The wheel, installed without extras where neither torch nor scipy exists, must run the runtime's tests by itself.
wheel: $(VENV)/.dev
	@rm -rf .build/wheel && mkdir -p .build
	$(BIN)/python -m build --wheel --outdir .build/wheel . >/dev/null

wheel-test: wheel
	tools/wheel-test.sh $(PYTHON)

# Five minutes of a core.
test-arm: wheel
	tools/arm-test.sh $(BIN)/python

# The wheel comes out of the sdist, so both are complete.
release-check: $(VENV)/.release
	@rm -rf dist .build/wheel && mkdir -p .build/wheel
	$(BIN)/python -m build --outdir dist . >/dev/null
	$(BIN)/python -m twine check --strict dist/*
	@cp dist/*.whl .build/wheel/
	tools/wheel-test.sh $(PYTHON) --once

# Under every other Python that the package claims; one that is not installed is left out and named. Where CI is set
# that is a failure, if apt has it.
wheel-test-others: wheel
	@for version in $(OTHER_PYTHONS); do \
	    if python=$$(tools/find-python.sh $$version); then tools/wheel-test.sh "$$python" --once --short || exit 1; \
	    else tools/no-python.sh $$version "Python $$version" || exit 1; fi; \
	done

# At the floors of pyproject.toml, which differ between the oldest Python that is claimed and the newest.
wheel-test-lowest: wheel
	@for version in $(firstword $(OTHER_PYTHONS)) $(lastword $(OTHER_PYTHONS)); do \
	    if python=$$(tools/find-python.sh $$version); then tools/wheel-test.sh "$$python" --once --lowest || exit 1; \
	    else tools/no-python.sh $$version "the lowest dependencies under Python $$version" || exit 1; fi; \
	done

# Without constraints: what a release of today breaks is a failure to be seen here, before a user sees it.
wheel-test-newest: wheel
	@version=$(lastword $(OTHER_PYTHONS)); python=$$(tools/find-python.sh $$version) || { python=$(PYTHON); \
	    tools/no-python.sh $$version "the newest dependencies under Python $$version" || exit 1; }; \
	    tools/wheel-test.sh "$$python" --once --newest

# Half an hour of a core in all. `bench tradeoff` needs phantoms, `bench peer` a package index.
bench: $(VENV)/.dev
	@for name in footprint frame dataset physics skip 'stability --quick' 'electrodes --quick'; do \
	    $(BIN)/eitskin bench $$name --json || exit 1; \
	done

firmware qemu: $(VENV)/.dev system-packages
	$(MAKE) -C firmware_proto $@ PYTHON=$(abspath $(BIN)/python)

powercut fuzz hotplug: $(VENV)/.dev system-packages
	$(BIN)/python -m tests.faults.$@

# ATTACK names what is passed on, such as `make attack ATTACK="--only connections --seed 7"`.
attack: $(VENV)/.dev system-packages
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.attack $(ATTACK)

SECONDS ?= 1200
soak: $(VENV)/.dev system-packages
	$(BIN)/python -m tests.faults.soak --seconds $(SECONDS)

clean:
	rm -rf .build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis

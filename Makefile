# Two commands do everything, their own set-up included: `make demo` and `make test`.
# PYTHON chooses the interpreter (3.11 or newer): make test PYTHON=python3.12
PYTHON ?= python3
BIN := .venv/bin
OCTROBOT := ljjax/data/octrobot
.DEFAULT_GOAL := help
.PHONY: help setup demo test check data recovery blind control-study circle bench clean

help: ## what this file can do
	@sed -n 's/^\([a-z-]*\):.*## /  make \1	/p' $(MAKEFILE_LIST)

.venv/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "ljjax needs Python 3.11 or newer; say which with: make PYTHON=/path/to/python3" >&2; exit 2; }
	@echo "Setting up .venv with pinned versions (once; a few minutes on a fresh machine)…"
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	@# Found on the path itself, so that a folder named ljjax in the user's current folder does not shadow it.
	@ln -sfn "$(CURDIR)/ljjax" "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/ljjax"
	@touch $@

setup: .venv/.ready ## the pinned environment in .venv

demo: .venv/.ready ## identify and diagnose OctRobot-I from its published measurements; writes out/demo/
	@$(BIN)/ljjax fit $(OCTROBOT)/identification.mcap $(OCTROBOT)/open_loop_stiffness.mcap --out out/demo/fit
	@$(BIN)/ljjax gap $(OCTROBOT)/identification.mcap $(OCTROBOT)/open_loop_stiffness.mcap \
	  $(OCTROBOT)/steady_tension.mcap --out out/demo/gap

check: .venv/.ready ## formatting, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

test: check ## everything that must hold; some twenty minutes on two cores
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder  # a file stays together: its programs compile once

data: .venv/.ready ## make the bundled MCAP logs anew from the published tables
	$(BIN)/python -m ljjax.data.make_octrobot_logs

recovery: .venv/.ready ## identify 40 simulated robots and compare with the truth; writes out/recovery/
	$(BIN)/python -m benchmarks.recovery.study

CASES ?= 20
JOBS ?= 2
blind: .venv/.ready ## diagnose robots whose effect is sealed, and score the answers (an hour on two cores); writes out/blind/
	$(BIN)/python -m benchmarks.blind.study $(if $(SEED),--seed $(SEED)) --cases $(CASES) --jobs $(JOBS)

control-study: .venv/.ready ## the control room's claims and the paper's experiments, measured; writes out/control/
	$(BIN)/python -m benchmarks.control.study

circle: .venv/.ready ## the full circle on an emulated rig, as a test of some eight minutes; wants a computer to itself
	$(BIN)/python -m pytest -m long tests/rig/test_full_circle.py

.venv/.bench: .venv/.ready
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test,bench]"
	@touch $@

bench: .venv/.bench ## speed side by side with other simulators; writes out/bench/
	$(BIN)/python -m benchmarks

clean: ## remove what the commands above made
	rm -rf .venv out build dist *.egg-info .pytest_cache .ruff_cache .hypothesis

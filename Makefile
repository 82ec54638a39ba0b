# bodyplan. `make` alone lists what there is.

CONFIG ?= experiments/configs/quickstart.toml
OUT ?= runs/quickstart
# Test processes. Every one of them keeps its maths libraries to one thread.
JOBS ?= 2

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

# The first Python of at least 3.11; 3.11 is preferred because every dependency has a wheel for it.
PYTHON ?= $(shell for p in python3.11 python3 python3.12 python3.13 python3.14 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo "$$p"; break; }; done)

# torch goes first and by itself, so that a CPU build is taken where the package index offers one, and a CUDA build
# where an NVIDIA GPU is found. BODYPLAN_TORCH may name another requirement, with pip options if need be:
#   make install BODYPLAN_TORCH="torch==2.12.0 --index-url <index of your choice>"
BODYPLAN_TORCH ?= $(shell if nvidia-smi -L >/dev/null 2>&1; then \
	echo "torch>=2.6,<2.14,!=2.13.0+cpu"; else echo "torch>=2.6,<2.14"; fi)

.DEFAULT_GOAL := help
.PHONY: help install run test check format bench picture clean distclean

help:  ## list the targets
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):[^#]*## /\1\t/' | \
		while IFS="$$(printf '\t')" read -r name text; do printf '  make %-10s %s\n' "$$name" "$$text"; done

install: $(STAMP)  ## make .venv with the bodyplan command (instant when nothing changed)

$(STAMP): pyproject.toml
	@if [ -z "$(PYTHON)" ]; then \
		echo "bodyplan needs Python 3.11 or newer and found none; install it, or name one: make install PYTHON=/path/to/python3" >&2; \
		exit 2; fi
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV) || { \
		echo "$(PYTHON) cannot make a virtual environment; on Debian and Ubuntu install python3-venv" >&2; exit 2; }
	@echo "installing bodyplan and what it needs into $(VENV) (some minutes the first time)"
	@$(BIN)/python -m pip install --quiet $(foreach word,$(BODYPLAN_TORCH),'$(word)')
	@$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $(STAMP)

run: install  ## evolve a small population and leave a robot to print in runs/quickstart (OUT=..., CONFIG=...)
	@$(BIN)/bodyplan run "$(CONFIG)" --out "$(OUT)" --resume

test: install  ## run the tests on JOBS=2 processes
	@$(ONE_THREAD) $(BIN)/python -m pytest -q -n $(JOBS) --dist loadscope

check: install  ## format, lint, types, layers
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(ONE_THREAD) $(BIN)/python -m pytest -q tests/test_layers.py tests/test_dependency_doors.py

format: install  ## rewrite the sources in the one format
	@$(BIN)/ruff check --fix --quiet . || true
	@$(BIN)/ruff format .

bench: install  ## measure: one table, docs/bench.json, and the table of the README (on an idle machine, some minutes)
	@$(ONE_THREAD) $(BIN)/python -m experiments.bench --out docs/bench.json --readme README.md

picture: install  ## draw docs/robot.png of the README from the run in OUT
	@$(BIN)/python -m experiments.cover "$(OUT)" --out docs/robot.png

clean:  ## remove caches (runs and .venv stay)
	@rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
	@find . -path ./$(VENV) -prune -o -type d -name __pycache__ -print | xargs rm -rf

distclean: clean  ## remove .venv too
	@rm -rf $(VENV)

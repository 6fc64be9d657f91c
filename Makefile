# `make demo` and `make test` need python3, git and make; everything else they set up in .venv.
PYTHON ?= python3
# Processes that share the quick tests.
JOBS ?= 2
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1

.PHONY: help setup demo test test-slow lint
help:           ## this list
	@sed -n 's/^\([a-z-]*\): .*## /make \1\t/p' Makefile | expand -t 20

setup: .venv/.stamp ## .venv with the pinned packages, and a Vulkan driver

.venv/.stamp: pyproject.toml constraints.txt scripts/setup.sh
	PYTHON=$(PYTHON) bash scripts/setup.sh

demo: .venv/.stamp  ## a robot that meets a situation it has not been trained in, and masters it
	PATH="$(CURDIR)/$(BIN):$$PATH" bash scripts/demo.sh

lint: .venv/.stamp  ## style, types, and which room may import which
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint          ## lint and every quick test
	$(BIN)/pytest -n $(JOBS) -m "not slow and not realtime"

test-slow: .venv/.stamp ## the tests that take minutes, and those that a busy machine fails
	$(BIN)/pytest -m "slow or realtime"

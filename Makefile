# make demo   sets up .venv, drives a robot through the three bundled worlds, prints a table; pictures in out/demo/
# make test   sets up .venv, runs linters, type checks and the fast tests
# make check  sets up .venv, runs the slow tests: browser, notebooks, the wheel with all commands of the pages
# make docs   sets up .venv, builds the site into out/docs/; opens with out/docs/index.html
PYTHON ?= python3
BIN := .venv/bin
PYTEST_ARGS ?= -n auto --dist loadscope

# Compiled modules are kept between workers and runs, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test check docs clean

demo: .venv/installed
	$(BIN)/lirs-wct validate simple medium advanced --robot husky --mapper hector --seconds 120 --seed 1 -o out/demo

test: .venv/kernels
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy benchmarks
	$(BIN)/lint-imports
	$(BIN)/pytest $(PYTEST_ARGS) -m "not slow"

check: .venv/kernels
	$(BIN)/pytest $(PYTEST_ARGS) -m slow

docs: .venv/installed-docs
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs out/docs

clean:
	rm -rf .venv out worlds dist

.venv/bin/python:
	$(PYTHON) -m venv .venv || { echo "needs Python 3.11 or newer with its venv module (Debian, Ubuntu: apt install python3-venv)"; rm -rf .venv; exit 1; }

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/installed-docs: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@ .venv/installed

.venv/installed-dev: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ .venv/installed

.venv/kernels: | .venv/installed-dev
	$(BIN)/python tests/compile_kernels.py
	@touch $@

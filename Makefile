# From a bare clone with nothing but Python 3.11 or newer: `make demo` and `make test`; `make help` names all targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: help demo test quick check docs fuzz man clean

help: ## this list
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' Makefile | expand -t 8

demo: $(VENV)/.installed ## the whole chain on embedded data, with pictures in lunarsci-demo
	$(BIN)/lunarsci demo --force

test: $(VENV)/.tested ## the whole suite
	$(BIN)/python -m pytest

quick: $(VENV)/.tested ## the quick part of the suite
	$(BIN)/python -m pytest -m quick

check: $(VENV)/.developed ## linter, formatter, types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.documented ## the documentation as pages for a browser, in docs/_build; any warning is an error
	$(BIN)/python -m sphinx -b html -q -W --keep-going docs docs/_build

$(BIN)/python:
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'lunarsci needs Python 3.11 or newer: make PYTHON=python3.11 ...')"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[report]'
	@touch $@

$(VENV)/.tested: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	@touch $@

$(VENV)/.developed: $(VENV)/.tested
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

$(VENV)/.documented: $(VENV)/.tested
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

fuzz: $(VENV)/.tested ## 100,000 spoilt files for every reader; some hours
	$(BIN)/python tests/benchmarks/fuzz.py

man: $(VENV)/.installed ## manual pages, into share/man/man1
	$(BIN)/python -m lunarsci.cli.manual share/man/man1

clean: ## removes what make has made
	rm -rf $(VENV) build dist *.egg-info lunarsci-demo share docs/_build docs/notebooks docs/jupyter_execute .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

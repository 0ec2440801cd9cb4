# From a bare clone with nothing but Python 3.11 or newer: `make demo` and `make test`; `make help` names all targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PYTESTFLAGS ?=
COMMA := ,

# What is installed and compiled here is read again, also where Python's own compiled files are switched off.
unexport PYTHONDONTWRITEBYTECODE

# uv installs some five times as fast as pip; where it cannot be had, or does not know the index, pip does the same. Like
# pip it trusts the certificates that this machine trusts.
define install
	@UV_SYSTEM_CERTS=1 $(BIN)/uv pip install --quiet --compile-bytecode --python $(BIN)/python --editable '.[$(1)]' 2>$(VENV)/.uv-errors \
		|| $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[$(1)]'
	@touch $@
endef

.PHONY: help demo test quick studies mutants oldest newest release check docs keys fuzz man clean FORCE

help: ## this list
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' Makefile | expand -t 8

demo: $(VENV)/.compiled ## the whole chain on embedded data, with pictures in lunarsci-demo
	$(BIN)/lunarsci demo --force

test: $(VENV)/.tested ## the whole suite
	$(BIN)/python -m pytest $(PYTESTFLAGS)

quick: $(VENV)/.quick ## truths by hand of every part, in plain Python: a minute
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m quick $(PYTESTFLAGS)

check: $(VENV)/.developed ## linter, formatter, types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.documented ## the documentation as pages for a browser, in docs/_build; any warning is an error
	$(BIN)/python -m sphinx -b html -q -W --keep-going docs docs/_build

COMMAND ?=
keys: $(VENV)/.installed ## what each key of --json means: make keys COMMAND="twin predict"
	@$(BIN)/python docs/_extension/pages_of_commands.py $(COMMAND)

# One environment for one Python: another PYTHON that is asked for gets a new one. What is half made is taken away.
VERSION := import sys; print("%d.%d" % sys.version_info[:2])
$(VENV)/.made: FORCE
	@if [ -e $@ ] && { [ "$(origin PYTHON)" = file ] || [ "$$($(PYTHON) -c '$(VERSION)')" = "$$(cat $@)" ]; }; then exit 0; fi; \
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'lunarsci needs Python 3.11 or newer: make PYTHON=python3.11 ...')" || exit 1; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
		echo "$(PYTHON) cannot make environments: on Debian and Ubuntu, apt-get install python3-venv; then make again" >&2; exit 1; }; \
	rm -rf $(VENV); \
	$(PYTHON) -m venv $(VENV) && $(PYTHON) -c '$(VERSION)' >$@ || { rm -rf $(VENV); exit 1; }; \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv || true

$(VENV)/.installed: pyproject.toml $(VENV)/.made
	$(call install,report$(COMMA)images)

# What bands, fit, forces, identify and predict compile is there before anybody waits for it.
$(VENV)/.compiled: $(VENV)/.installed
	-$(BIN)/lunarsci doctor
	@touch $@

$(VENV)/.quick: pyproject.toml $(VENV)/.made
	$(call install,quick)

$(VENV)/.tested: $(VENV)/.installed
	$(call install,test)

$(VENV)/.developed: $(VENV)/.tested
	$(call install,dev)

$(VENV)/.documented: $(VENV)/.tested
	$(call install,docs)

FORCE:

studies: $(VENV)/.tested ## whole coverage studies, every point of a kill, loops from pictures; some minutes
	$(BIN)/python -m pytest -m study $(PYTESTFLAGS)

MUTANTS ?= --count 150
mutants: $(VENV)/.tested ## faults planted at random in the science, and which of them no test sees; some hours
	$(BIN)/python tests/benchmarks/mutants.py $(MUTANTS)

# With other packages than the latest that fit together, in an environment of its own: what is asked of uv, and what follows.
define try
	$(PYTHON) -m venv --clear .venv-$@
	.venv-$@/bin/python -m pip install --quiet --disable-pip-version-check uv
	UV_SYSTEM_CERTS=1 .venv-$@/bin/uv pip install --quiet --only-binary :all: --no-binary lunarsci --python .venv-$@/bin/python $(1) --editable '.[quick,report]'
	$(2)
	.venv-$@/bin/uv pip list --quiet --python .venv-$@/bin/python
	NUMBA_CACHE_DIR=$(CURDIR)/.venv-$@/numba .venv-$@/bin/lunarsci doctor
	cd .venv-$@ && NUMBA_CACHE_DIR=$(CURDIR)/.venv-$@/numba bin/lunarsci demo --force
	NUMBA_DISABLE_JIT=1 .venv-$@/bin/python -m pytest -m quick $(PYTESTFLAGS)
endef

oldest: ## the whole chain and quick tests with the oldest packages that pyproject.toml allows
	$(call try,--resolution lowest-direct)

# Compiled code stands on numba's insides, which may change with any release.
newest: ## the same with the newest, whatever numba pyproject.toml allows, and tests of compiled code
	$(call try,--upgrade,.venv-$@/bin/python -m pip install --quiet --upgrade --no-deps numba llvmlite)
	NUMBA_CACHE_DIR=$(CURDIR)/.venv-$@/numba .venv-$@/bin/python -m pytest tests/compiled tests/regolith $(PYTESTFLAGS)

# The wheel runs in an environment and a folder that have nothing else.
RELEASE := .venv-release
release: ## wheel and source distribution in dist, looked at, and the wheel tried in an empty folder
	rm -rf dist build *.egg-info
	$(PYTHON) -m venv --clear $(RELEASE)
	$(RELEASE)/bin/python -m pip install --quiet --disable-pip-version-check build twine check-wheel-contents
	$(RELEASE)/bin/python -m build >$(RELEASE)/build.log 2>&1 || { cat $(RELEASE)/build.log; exit 1; }
	$(RELEASE)/bin/twine check --strict dist/*
	$(RELEASE)/bin/check-wheel-contents dist/*.whl
	tar tzf dist/*.tar.gz | sed 's|^[^/]*/||' | sort >$(RELEASE)/packed
	if git ls-files | sort | comm -23 - $(RELEASE)/packed | grep .; then echo "not in the source distribution" >&2; exit 1; fi
	$(PYTHON) -m venv --clear $(RELEASE)
	$(RELEASE)/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl
	mkdir $(RELEASE)/empty && cd $(RELEASE)/empty && for line in --version doctor \
		"spectra simulate --rock ol=0.1,opx=0.4,cpx=0.2,plg=0.3 -o scene" "spectra calibrate scene -o rock.ecsv" "spectra bands rock.ecsv" \
		"regolith forces --load 36.5" "template plan -o plan.toml" "twin predict plan.toml --members 4"; do \
		echo "lunarsci $$line"; NUMBA_CACHE_DIR=$$PWD/numba ../bin/lunarsci $$line || [ $$? = 3 ] || exit 1; done

fuzz: $(VENV)/.tested ## 100,000 spoilt files for every reader; some hours
	$(BIN)/python tests/benchmarks/fuzz.py

man: $(VENV)/.installed ## manual pages, into share/man/man1
	$(BIN)/python -m lunarsci.cli.manual share/man/man1

clean: ## removes what make has made
	rm -rf $(VENV) .venv-oldest .venv-newest $(RELEASE) build dist *.egg-info lunarsci-demo share docs/_build docs/notebooks docs/jupyter_execute .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

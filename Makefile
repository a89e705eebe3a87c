# From a bare Python 3.11 to 3.13 and make to everything here. `make` alone lists what there is.

PYTHONS := python3.11 python3.12 python3.13 python3
# One more than two cores: many tests wait for a process or a clock. Each takes up to 4 GB.
TEST_PROCESSES ?= 3
# Order of the tests: make test ORDER= runs them in random order and prints the seed.
ORDER ?= -p no:randomly

BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
# Build tools (setuptools) come from the same list as everything else.
INSTALL := $(PIP) install --constraint constraints.txt --build-constraint constraints.txt

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help start demo test slow mutants check style types layers doctests exports documentation docs bench clean budget

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' Makefile | expand -t 8

# Without a rig, a camera or a scale: the page begins with virtual ones.
start: .venv/studio.stamp ## open the first page: from a plugged-in or virtual sensor to live newtons
	$(BIN)/palpate start --folder "$$HOME/palpate/my-sensor"

# One thread: its images are small, and threads that wait for each other take the cores from the renderer.
demo: .venv/sense.stamp ## render a recording, calibrate, evaluate, sense, report; no torch, no data
	@out=demo-out; n=1; \
	while [ -e "$$out" ]; do n=$$((n + 1)); out=demo-out-$$n; done; \
	echo "palpate demo --out $$out"; \
	OMP_NUM_THREADS=1 $(BIN)/palpate demo --out "$$out" && \
	echo "palpate itself is $(BIN)/palpate: try $(BIN)/palpate --help"

# One thread a process: processes with two threads each would fight over two cores. Bytecode is kept
# whatever the environment says: some hundred tests start a process, and each would compile palpate anew.
test: .venv/work.stamp ## run the tests that take seconds
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" -n $(TEST_PROCESSES) --dist loadscope $(ORDER)

slow: .venv/work.stamp ## run the tests that take minutes
	$(BIN)/python -m pytest -m slow --timeout=3600

# One line after another is changed on a copy; MUTANTS="--only n3" runs one of them.
mutants: .venv/work.stamp ## see that the nearest tests notice each line changed in the frozen list
	PYTHONPATH=tools OMP_NUM_THREADS=1 $(BIN)/python -m mutants $(MUTANTS)

check: style types layers budget doctests exports documentation ## style, types, layers, size, doctests, exports, documentation

style: .venv/work.stamp
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .

types: .venv/work.stamp
	$(BIN)/python -m mypy

layers: .venv/work.stamp
	$(BIN)/lint-imports

budget: .venv/work.stamp ## measure the size of the package against its limits
	$(BIN)/python tools/budget.py

doctests: .venv/work.stamp
	$(BIN)/python -m pytest --doctest-modules src/palpate reproductions/src

exports: .venv/work.stamp
	$(BIN)/python -m pytest tests/laws/test_house.py

documentation: .venv/work.stamp
	@site=$$(mktemp -d) && trap 'rm -rf "$$site"' EXIT && \
	$(BIN)/python -m mkdocs build --strict --site-dir "$$site"

docs: .venv/work.stamp ## build the documentation into site/
	$(BIN)/python -m mkdocs build --strict

bench: .venv/work.stamp ## run every benchmark, each beside its own baseline
	@for file in benchmarks/*/[a-z]*.py; do \
		echo "== $$file"; $(BIN)/python "$$file" || exit 1; \
	done

clean: ## remove the environment, caches and built documentation; demo-out folders stay
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache \
		site build dist reproductions/build reproductions/dist src/*.egg-info reproductions/src/*.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp is written last, so an installation that fails is tried again.
.venv/sense.stamp: pyproject.toml reproductions/pyproject.toml constraints.txt
	@test -x $(BIN)/python || { $(find-python); "$$python" -m venv --clear .venv; }
	@echo "installing palpate into .venv; the first time takes a minute or more"
	$(PIP) install --constraint constraints.txt --upgrade pip
	$(INSTALL) --editable . --editable ./reproductions
	@touch $@

.venv/studio.stamp: .venv/sense.stamp
	$(INSTALL) --editable '.[studio,rig]'
	@touch $@

.venv/work.stamp: .venv/sense.stamp
	@echo "installing what trains, tests and checks into .venv; the first time takes minutes"
	$(INSTALL) --editable '.[train]' --group test --group check --group docs
	@touch $@

# Sets the shell's $python: PYTHON where given, else the first on the path that is 3.11 to 3.13.
# Asked to run, since a name on the path may be a version manager's shim for nothing.
define find-python
python=; for candidate in $(or $(PYTHON),$(PYTHONS)); do \
	if "$$candidate" -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' \
		>/dev/null 2>&1; then python=$$candidate; break; fi; \
done; \
if [ -z "$$python" ]; then \
	echo "palpate needs Python 3.11, 3.12 or 3.13 with venv and ensurepip; none among:" \
		"$(or $(PYTHON),$(PYTHONS)). Install one, or name it: make PYTHON=/path/to/python3.11 ..." >&2; \
	exit 1; \
fi
endef

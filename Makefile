# What a developer runs, and .ci/run, too. The environment is .venv; another one: make test VENV=FOLDER.
VENV ?= .venv
PYTHON = $(VENV)/bin/python
SOURCES = torchjoint/csrc/*.cpp torchjoint/csrc/*.h
export PIP_CONSTRAINT ?= $(CURDIR)/constraints.txt
export PIP_BUILD_CONSTRAINT ?= $(CURDIR)/constraints.txt
# Processes share the processors here: a thread that waits for its neighbours sleeps, and does not spin.
export OMP_WAIT_POLICY ?= passive

.PHONY: ci coverage docs figures format fuzz install kills layers lint notebooks races sanitize slow test types wheels

install: # as README's test command does
	python3 -m venv $(VENV)
	$(PYTHON) -m pip install -e '.[test]' -e lab

test:
	$(PYTHON) -m pytest -n 2

slow: # the sweeps and lab, which `test` leaves out
	$(PYTHON) -m pytest -n 2 -m "slow or lab" tests torchjoint lab

coverage: # which lines the tests run
	$(PYTHON) -m pytest -n 2 --cov --cov-report=term:skip-covered --cov-report=html:build/coverage

format:
	$(VENV)/bin/ruff format .
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/clang-format -i $(SOURCES)

lint:
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check --no-cache .
	$(VENV)/bin/clang-format --dry-run -Werror $(SOURCES)

types:
	$(VENV)/bin/mypy

layers: # which folder imports which: docs/ARCHITECTURE.md
	$(VENV)/bin/lint-imports --no-cache

docs: # the site: each link within it, and each name that a docstring refers to, exists
	$(PYTHON) -m sphinx -nW --keep-going -q -j 2 -c docs . build/site

kills: # runs that are killed end with the same files
	$(PYTHON) benchmarks/kills.py --kills 10

fuzz: # random inputs and damaged files crash nothing
	$(PYTHON) benchmarks/fuzz.py --operators 20000 --files 2000 --results 300 --outputs 1000 --foreign 300

sanitize: # the operators under the address and the undefined-behaviour sanitizer
	.ci/sanitize $(PYTHON)

races: # the operators, called from several threads, under the thread sanitizer
	.ci/sanitize $(PYTHON) thread

wheels: # the wheel, in an environment with what it brings and no compiler
	.ci/wheels --quick build/wheels $(PYTHON)

notebooks: # their kernel is the environment's own
	$(PYTHON) -m pytest --nbmake --nbmake-timeout=300 --override-ini=addopts= notebooks

figures: # how light the package is; fails above the limits
	$(PYTHON) benchmarks/light.py --check

ci: # all of it, on a fresh clone of the last commit
	.ci/run

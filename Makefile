# Two commands: `make demo` and `make test`. Each builds what it needs, with Python and make alone.
PYTHON ?= python3

# A worker a core; each keeps to one thread of linear algebra (tests/conftest.py).
WORKERS = -m pytest -n logical --dist loadscope
PYTEST = .venv-test/bin/python $(WORKERS)
PIP_INSTALL = python -m pip install --quiet --disable-pip-version-check

.PHONY: demo docs test test-all reference golden thresholds test-floors test-newest test-opticalib browser lint types contracts house sizes format clean

demo: .venv-demo/ready
	.venv-demo/bin/truenewton demo --overwrite

test: .venv-test/ready
	$(PYTEST) -m "not study"

# The statistical studies too, and which lines and branches no test reaches.
test-all: .venv-test/ready
	$(PYTEST) --cov

# Records the reference results anew, and prints what differs: `make reference CASES="p45 plan"`.
reference: .venv-test/ready
	PYTHONPATH=.:tests OPENBLAS_NUM_THREADS=1 .venv-test/bin/python -m reference $(CASES)

# Which outputs of 30 commands differ from the recorded ones; `make golden RECORD=1` records them.
golden: .venv-test/ready
	PYTHONPATH=.:tests OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 .venv-test/bin/python -m reference.golden $(if $(RECORD),--record)

# Multiplies each constant that decides about data by three: a test of its package must fail (long).
thresholds: .venv-test/ready
	PYTHONPATH=src:.:tests .venv-test/bin/python -m helpers.thresholds $(CASES)

# With the floors of pyproject.toml. Old packages may use what the newest below them deprecate.
test-floors: .venv-floors/ready
	.venv-floors/bin/python $(WORKERS) -m "not study" -W default::DeprecationWarning

# With the newest of everything, anew each time; what passes goes into constraints.txt.
test-newest:
	$(PYTHON) -m venv .venv-newest
	.venv-newest/bin/$(PIP_INSTALL) --upgrade --upgrade-strategy eager -e .[test]
	.venv-newest/bin/python $(WORKERS) -m "not study"

# The site, into docs/_build; what its tutorials show is computed here. A terminal shows how far it is.
docs: .venv-docs/ready
	@echo "computing the tutorials and writing all pages: some minutes"
	@OPENBLAS_NUM_THREADS=1 .venv-docs/bin/python -m sphinx $$(test -t 1 || echo --quiet) --fail-on-warning --keep-going --nitpicky docs docs/_build
	.venv-docs/bin/python docs/searched.py docs/_build

# Against the published opticalib: 0.7 GB, so it is not part of `make test-all`.
test-opticalib: .venv-opticalib/ready
	.venv-opticalib/bin/python -m pytest tests/bench/test_opticalib.py

# axe-core, with which the tests judge whether the report's page can be used by all; needs npm.
browser:
	npm install --silent --no-audit --no-fund --prefix .browser axe-core@4.14.1

lint: .venv-test/ready
	.venv-test/bin/ruff check .
	.venv-test/bin/ruff format --check .

types: .venv-test/ready
	.venv-test/bin/mypy
	.venv-test/bin/python docs/examples.py

contracts: .venv-test/ready
	.venv-test/bin/lint-imports

# The packages as a picture, from the import contract; what is largest, and the decisions of each.
house: .venv-test/ready
	.venv-test/bin/python docs/house.py

sizes: .venv-test/ready
	.venv-test/bin/python docs/house.py --sizes

format: .venv-test/ready
	.venv-test/bin/ruff check --fix .
	.venv-test/bin/ruff format .

.venv-demo/ready: pyproject.toml constraints.txt $(shell find src -type f -not -name '*.pyc')
	$(PYTHON) -m venv .venv-demo
	.venv-demo/bin/$(PIP_INSTALL) -c constraints.txt .
	touch $@

.venv-test/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-test
	.venv-test/bin/$(PIP_INSTALL) -c constraints.txt -e .[dev]
	touch $@

.venv-floors/ready: pyproject.toml tests/helpers/floors.py
	$(PYTHON) -m venv --clear .venv-floors
	$(PYTHON) tests/helpers/floors.py > .venv-floors/floors.txt
	.venv-floors/bin/$(PIP_INSTALL) -c .venv-floors/floors.txt -e .[test]
	touch $@

.venv-docs/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/$(PIP_INSTALL) -c constraints.txt -e .[docs]
	touch $@

.venv-opticalib/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-opticalib
	.venv-opticalib/bin/$(PIP_INSTALL) -c constraints.txt -e .[test] "opticalib>=2.3,<3"
	touch $@

clean:
	rm -rf .venv-demo .venv-docs .venv-test .venv-floors .venv-newest .venv-opticalib .browser .coverage docs/_build

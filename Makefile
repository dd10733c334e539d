# Two commands: `make demo` and `make test`. Each builds what it needs, with Python and make alone.
PYTHON ?= python3

.PHONY: demo test lint types contracts format clean

demo: .venv-demo/ready
	.venv-demo/bin/truenewton demo --overwrite

test: .venv-test/ready
	.venv-test/bin/python -m pytest

lint: .venv-test/ready
	.venv-test/bin/ruff check .
	.venv-test/bin/ruff format --check .

types: .venv-test/ready
	.venv-test/bin/mypy

contracts: .venv-test/ready
	.venv-test/bin/lint-imports

format: .venv-test/ready
	.venv-test/bin/ruff check --fix .
	.venv-test/bin/ruff format .

.venv-demo/ready: pyproject.toml constraints.txt $(shell find src -name '*.py')
	$(PYTHON) -m venv .venv-demo
	.venv-demo/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt .
	touch $@

.venv-test/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-test
	.venv-test/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .[dev]
	touch $@

clean:
	rm -rf .venv-demo .venv-test

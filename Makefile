# make demo   sets everything up and runs the main job
# make test   sets everything up, lints, type-checks and passes the tests
PYTHON ?= $(shell command -v python3.11 || command -v python3)
PIP_INSTALL = .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint clean

demo: .venv/installed-demo
	.venv/bin/nufleet demo

test: .venv/installed-test lint
	@echo "== tests"
	.venv/bin/pytest

lint: .venv/installed-test
	@echo "== lint, format and types"
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

.venv/bin/python:
	@echo "== making .venv with $(PYTHON)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "nufleet needs Python 3.11 or newer; say which with make PYTHON=..."; exit 2; }
	$(PYTHON) -m venv .venv

.venv/installed-demo: .venv/bin/python pyproject.toml constraints.txt
	@echo "== installing nufleet and what it needs (once; about a minute)"
	$(PIP_INSTALL) -e .
	@echo "== compiling the numerics (once)"
	.venv/bin/python -c 'from shared.gaussian_process import warm_up; warm_up()'
	@touch $@

.venv/installed-test: .venv/installed-demo
	@echo "== installing what the tests need (once)"
	$(PIP_INSTALL) -e '.[test]'
	@touch $@

clean:
	rm -rf .venv .mypy_cache .ruff_cache .hypothesis

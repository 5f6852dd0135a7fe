# `make demo` and `make test` do their own set-up, from nothing but Python and a Debian underneath.

PYTHON := .venv/bin/python
SETUP := pyproject.toml constraints.txt scripts/setup.sh

.PHONY: demo test lint clean

demo: .venv/.ready-demo
	.venv/bin/fabdesign demo -o demo

test: lint
	$(PYTHON) -m pytest --cov --cov-report=term

lint: .venv/.ready-test
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy

clean:
	rm -rf .venv demo build *.egg-info

.venv/.ready-demo: $(SETUP)
	scripts/setup.sh
	touch $@

.venv/.ready-test: $(SETUP)
	scripts/setup.sh clouds,dev,dxf,mesh,rig
	touch $@

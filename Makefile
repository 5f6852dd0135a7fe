# `make demo` and `make test` do their own set-up, from nothing but Python and a Debian underneath.

PYTHON := .venv/bin/python
EXTRAS := clouds,corrector,dev,dxf,mesh,studio# without corrector, tests that need PyTorch skip
SETUP := pyproject.toml constraints.txt scripts/setup.sh

.PHONY: demo test lint clean reference verify-sim verify-trace bench-sim loop

demo: .venv/.ready-demo
	.venv/bin/fabdesign demo -o demo

test: lint
	$(PYTHON) -m pytest -m "not verify" -n 2 --dist worksteal --cov --cov-report=term

lint: .venv/.ready-test
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy

# the checks of tests/verify (that of the studio in a browser skips without chromium); writes docs/results/simulator_verification.md
verify-sim: .venv/.ready-test
	FABDESIGN_VERIFICATION_TABLE=1 $(PYTHON) -m pytest tests/verify

# traces of the synthetic rig's sets whose effects are known; hours, goes on where it stood; its part of docs/results/trace.md
verify-trace: .venv/.ready-test
	$(PYTHON) -m benchmarks.trace .benchmarks/trace --page

# what a motion costs, beside bounds and others, 20 minutes; writes its part of docs/results/simulator.md
bench-sim: .venv/.ready-bench
	$(PYTHON) -m benchmarks.sim

# six loops on virtual rigs, in parts: what is done is kept in build/loop; writes docs/results/loop.md
loop: .venv/.ready-test
	$(PYTHON) -m benchmarks.loop

# the Python interface's reference, from its docstrings: build/reference/index.html
reference: .venv/.ready-reference
	$(PYTHON) -m pdoc -o build/reference --math fabdesign.interface fabdesign.design fabdesign.muscle fabdesign.fabric \
		fabdesign.model fabdesign.effects sim.simulator

clean:
	rm -rf .venv demo build *.egg-info

.venv/.ready-demo: $(SETUP)
	scripts/setup.sh
	touch $@

.venv/.ready-test: $(SETUP)
	scripts/setup.sh $(EXTRAS)
	touch $@

.venv/.ready-reference: $(SETUP)
	scripts/setup.sh docs
	touch $@

.venv/.ready-bench: $(SETUP)
	scripts/setup.sh bench
	touch $@

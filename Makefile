# `make demo` and `make test` do their own set-up, from nothing but Python and a Debian underneath.

PYTHON := .venv/bin/python
EXTRAS := board,clouds,cluster,corrector,dev,dxf,export,mocap,optuna,realsense,ros,studio,tables# without corrector, tests that need PyTorch skip
SETUP := pyproject.toml constraints.txt scripts/setup.sh

.PHONY: demo test coverage lint clean docs reference wheel wheel-test verify-sim verify-cluster verify-trace bench-sim bench-search bench-recordings bench-follow loop

demo: .venv/.ready-demo
	.venv/bin/fabdesign demo -o demo

# processes that tests start load compiled sources, also where the environment says that none are written
test: lint
	PYTHONDONTWRITEBYTECODE= $(PYTHON) -m pytest -m "not verify" -n 2 --dist worksteal

# the tests once more, and which lines they reach; half as much processor time again
coverage: .venv/.ready-test
	$(PYTHON) -m pytest -m "not verify" -n 2 --dist worksteal --cov --cov-report=term

lint: .venv/.ready-test
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	$(PYTHON) scripts/sentences.py >/dev/null

# the checks of tests/verify; writes docs/lab/simulator_verification.md
verify-sim: .venv/.ready-test
	FABDESIGN_VERIFICATION_TABLE=1 $(PYTHON) -m pytest tests/verify

# a scheduler and workers as processes here, one or the other killed in the middle of a sweep and of a search
verify-cluster: .venv/.ready-test
	$(PYTHON) -m pytest tests/verify/test_verify_cluster.py tests/cluster/test_cluster.py

# traces of the virtual rig's sets whose effects are known; a day, goes on where it stood, QUICK=1 for six sets; its part of docs/lab/trace.md
verify-trace: .venv/.ready-test
	$(PYTHON) -m benchmarks.trace .benchmarks/trace --page $(if $(QUICK),--quick)

# what a motion costs, beside bounds and others, 20 minutes; writes its part of docs/lab/simulator.md
bench-sim: .venv/.ready-bench
	$(PYTHON) -m benchmarks.sim

# the search on targets of the virtual rig, in parts: what is done is kept in build/search; QUICK=1 for a small one; writes its part of docs/lab/search.md
bench-search: .venv/.ready-test
	$(PYTHON) -m benchmarks.search

# twelve motions that a cloth is to follow, and two devices that are not the model, in parts: what is done is kept in build/follow; writes its part of docs/lab/follow.md
bench-follow: .venv/.ready-test
	$(PYTHON) -m benchmarks.follow build/follow --page

# recordings by the RealSense SDK's own recorder from virtual cameras, 10 minutes; writes its part of docs/lab/fuse.md
bench-recordings: .venv/.ready-test
	for version in 2.56.5.9235 2.59.1.11053; do \
		$(PYTHON) -m pip install --quiet --no-deps --target build/realsense-$$version pyrealsense2==$$version; done
	$(PYTHON) -m benchmarks.recordings build/recordings --sdk build/realsense-2.56.5.9235 \
		--sdk build/realsense-2.59.1.11053 --page

# six loops on virtual rigs, in parts: what is done is kept in build/loop; writes its part of docs/lab/loop.md
loop: .venv/.ready-test
	$(PYTHON) -m benchmarks.loop

# the documentation with the Python interface's reference, from docs and docstrings: build/docs/index.html, read without a network
docs: .venv/.ready-docs
	$(PYTHON) -m sphinx -W --keep-going -q -b html docs build/docs

reference: docs # its former name: build/docs/reference.html

# dist/*.whl and dist/*.tar.gz
wheel: .venv/.ready-test
	$(PYTHON) -m build

# the wheel in an empty environment of every Python that is here, outside the repository; downloads packages
wheel-test: wheel
	scripts/wheel_test.sh dist/*.whl

clean:
	rm -rf .venv demo build dist *.egg-info

.venv/.ready-demo: $(SETUP)
	scripts/setup.sh
	.venv/bin/fabdesign prepare
	touch $@

.venv/.ready-test: $(SETUP)
	scripts/setup.sh $(EXTRAS)
	touch $@

.venv/.ready-docs: $(SETUP)
	scripts/setup.sh docs
	touch $@

.venv/.ready-bench: $(SETUP)
	scripts/setup.sh bench
	touch $@

# Two commands for a fresh machine: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ARGS ?=
GROUNDSTATION_LOCAL_DATA ?= local-data
# Byte code is kept: without it every worker reads and rewrites all test files anew, 7 s each.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run demo test test-usb check-local lint mutants bench bench-real bench-discrepancy soak clean

run: $(VENV)/.ready
	$(BIN)/groundstation run --link stand-in --viewer serve --page $(ARGS)

# The whole story on the software craft, and a report: `make demo ARGS="--seed 3"` for another.
demo: $(VENV)/.ready-dev
	$(BIN)/groundstation demo $(ARGS)

# Each worker takes a stretch of neighbours: what a file's tests share is made once. One worker more
# than there are cores, for some tests wait for real time.
test: $(VENV)/.ready-dev
	$(MAKE) --output-sync -j2 lint $(VENV)/.compiled
	$(BIN)/pytest -n $$(($$(nproc) + 1)) --dist worksteal $(ARGS)

# Byte code and numba's cache, for every program that the tests start.
$(VENV)/.compiled: $(VENV)/.ready-dev $(shell find groundstation firmware_sim -name '*.py')
	$(BIN)/python -m compileall -q groundstation firmware_sim
	$(BIN)/python tests/helpers/compiled.py
	touch $@

# The USB link through a real kernel, in a virtual machine: about ten minutes, and qemu-system-x86,
# busybox-static, kmod, cpio and usbip.
test-usb: $(VENV)/.ready-dev
	$(BIN)/pytest tests/usb_vm -s -v -o faulthandler_timeout=0 $(ARGS)

# Recordings that may not be committed: a folder with usd_card/, imrc/, imrc_brushed/, imrc_payload/
# and nanobench/, or some of them. What its flights must show, a line each, then the tests.
check-local: $(VENV)/.ready-dev
	@$(BIN)/python -m bench.real $(GROUNDSTATION_LOCAL_DATA) accept; accepted=$$?; \
	GROUNDSTATION_LOCAL_DATA=$(GROUNDSTATION_LOCAL_DATA) $(BIN)/pytest tests/local $(ARGS) \
	&& exit $$accepted

# Fits and findings on real flights beside estimates made apart: `make bench-real ARGS="fit agreement"`.
bench-real: $(VENV)/.ready-dev
	$(BIN)/python -m bench.real $(GROUNDSTATION_LOCAL_DATA) $(ARGS)

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Faults put in one at a time, in memory only: each has to fail a test of the short suite.
mutants: $(VENV)/.ready-dev $(VENV)/.compiled
	$(BIN)/python -m bench.mutants $(ARGS)

bench: $(VENV)/.ready-dev
	$(BIN)/python -m bench $(ARGS)

# Hidden effects by the hundred, found and judged; sizes by ARGS, for example
# ARGS="--only single --seeds 2 --results results". A run that was stopped goes on.
bench-discrepancy: $(VENV)/.ready-dev
	$(BIN)/python -m bench.sealed run $(ARGS)

$(VENV)/.ready: pyproject.toml constraints.txt
	@echo "once: an environment of its own in $(VENV)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "once: groundstation and its libraries (about a minute)"
	@$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	@echo "once: what tests, demo and radio need besides"
	@$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev,radio,logs,fleet]'
	touch $@

# A day of telemetry through the real daemon, every file verified: `make soak ARGS="--hours 2"`.
soak: $(VENV)/.ready-dev
	$(BIN)/python -m bench.soak $(ARGS)

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

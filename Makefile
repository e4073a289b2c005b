# Two commands for a fresh machine: `make run` and `make test`. `make help` lists all.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ARGS ?=
GROUNDSTATION_LOCAL_DATA ?= local-data
# Byte code is kept: without it every worker reads and rewrites all test files anew, 7 s each.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help run demo test test-all test-long test-durations nightly test-usb check-local lint docs \
	wheel bench bench-real bench-discrepancy soak clean

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 26

run: $(VENV)/.ready ## the software craft, live: recorded, with viewer and page
	$(BIN)/groundstation run --link stand-in --viewer serve --page $(ARGS)

demo: $(VENV)/.ready-dev ## a software craft is learnt and a report, some 4 minutes; ARGS="--hide 3" for another
	$(BIN)/groundstation learn --link software:crazyflie21 --hide 1 $(ARGS)

# Each worker takes a run of neighbours: what a file's tests share is made once. One worker more
# than there are cores, for some tests wait for real time.
PYTEST := $(BIN)/pytest -n $$(($$(nproc) + 1)) --dist worksteal
test: $(VENV)/.ready-dev ## lint and the tests that protect safety, data and the main job: five minutes
	$(MAKE) --output-sync -j2 lint $(VENV)/.compiled
	$(PYTEST) --part short $(ARGS)

test-all: $(VENV)/.ready-dev ## every test: some 20 minutes on two cores
	$(MAKE) --output-sync -j2 lint $(VENV)/.compiled
	$(PYTEST) $(ARGS)

test-long: $(VENV)/.ready-dev $(VENV)/.compiled ## what `make test` leaves out: tests/long_tests.txt
	$(PYTEST) --part long $(ARGS)

# What may move a motor, what the daemon promises, who gets in: a race of them shows in one run of
# many. In CI by night.
nightly: $(VENV)/.ready-dev $(VENV)/.compiled ## tests of safety, service, attack and learn ten times over, to the first failure
	for time in 1 2 3 4 5 6 7 8 9 10; do \
		echo "time $$time of 10"; \
		$(PYTEST) -x tests/safety tests/service tests/attack tests/learn $(ARGS) || exit; \
	done

test-durations: $(VENV)/.ready-dev $(VENV)/.compiled ## measures every test, writes that list anew
	$(PYTEST) --durations-to $(VENV)/durations.json $(ARGS)
	PYTHONPATH=tests $(BIN)/python -m support.suite $(VENV)/durations.json

# Byte code and compiled kernels, for every program that the tests start.
$(VENV)/.compiled: $(VENV)/.ready-dev $(shell find groundstation firmware_sim -name '*.py')
	$(BIN)/python -m compileall -q groundstation firmware_sim
	PYTHONPATH=tests $(BIN)/python -m support.compiled
	touch $@

# Needs qemu-system-x86, busybox-static, kmod and cpio.
test-usb: $(VENV)/.ready-dev ## USB through a real kernel, in a virtual machine: five minutes
	$(BIN)/pytest tests/usb_vm -s -v -o faulthandler_timeout=0 $(ARGS)

# A folder with usd_card/, imrc/, imrc_brushed/, imrc_payload/ and nanobench/, or some of them. What
# its flights must show, a line each, then the tests.
check-local: $(VENV)/.ready-dev ## recordings that may not be published: what they must show, and tests
	@$(BIN)/python -m bench.real $(GROUNDSTATION_LOCAL_DATA) accept; accepted=$$?; \
	GROUNDSTATION_LOCAL_DATA=$(GROUNDSTATION_LOCAL_DATA) $(BIN)/pytest tests/local $(ARGS) \
	&& exit $$accepted

bench-real: $(VENV)/.ready-dev ## fits and findings on real flights beside estimates made apart
	$(BIN)/python -m bench.real $(GROUNDSTATION_LOCAL_DATA) $(ARGS)

lint: $(VENV)/.ready-dev ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.ready-dev ## the documentation as a site, which the page serves under Help
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "groundstation/page/site/index.html"

wheel: docs ## source distribution and wheel in dist/, checked
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl

bench: $(VENV)/.ready-dev ## what is fast, beside a reference in the same run
	$(BIN)/python -m bench $(ARGS)

# For example ARGS="--only single --seeds 2 --results results". A run that was stopped goes on.
bench-discrepancy: $(VENV)/.ready-dev ## hidden effects by the hundred, found and judged
	$(BIN)/python -m bench.sealed run $(ARGS)

$(VENV)/.ready: pyproject.toml constraints.txt
	@echo "once: an environment of its own in $(VENV)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "once: groundstation and its libraries (about a minute)"
	@$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[viewer]'
	touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	@echo "once: what tests, demo and radio need besides"
	@$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[viewer,docs,dev,radio,logs,fleet]'
	touch $@

soak: $(VENV)/.ready-dev ## a day of telemetry through the daemon, every file verified; ARGS="--hours 2"
	$(BIN)/python -m bench.soak $(ARGS)

clean: ## removes the environment and what was built
	rm -rf $(VENV) build dist groundstation/page/site *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

# Every target sets up what it needs: a fresh clone needs only make and Python 3.11 or newer.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: system demo test virtual realtime lint types layers doctest docs examples screenshots dist deb try-deb check older lowest bench fuzz soak clean help

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[fleet,web,history,mqtt,export]' --group test --group check --group site
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps MAVProxy==1.8.75
	@echo "compiling what judges and what flies, once ..."
	@$(BIN)/mavdiag warm & $(BIN)/sitl-plant record --duration 1 -o $(VENV)/warm.tlog; wait
	@touch $@

system:  ## Chromium, Mosquitto, PostgreSQL and help2man for what uses them, where this may install them
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  command -v chromedriver >/dev/null && command -v /usr/sbin/mosquitto >/dev/null && command -v help2man >/dev/null && ls /usr/lib/postgresql/*/bin/postgres >/dev/null 2>&1 || \
	  { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends \
	    chromium chromium-driver fonts-dejavu-core mosquitto postgresql help2man; } >/dev/null 2>&1 || \
	  echo "system: not installed; the tests that need them are skipped"; \
	else echo "system: not root, or no apt-get; tests of what is missing are skipped"; fi

demo: $(STAMP)  ## the main job: plant, detector and alert over MAVLink on loopback
	$(BIN)/mavdiag demo

test: virtual realtime  ## the whole test suite

virtual: $(STAMP)  ## the tests that need no wall clock
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not realtime"

realtime: $(STAMP)  ## those that need it, and the machine for themselves
	$(BIN)/python -m pytest -n 3 --dist loadfile -m realtime

lint: $(STAMP)  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)  ## mypy --strict
	$(BIN)/mypy

layers: $(STAMP)  ## the import contracts
	$(BIN)/lint-imports

doctest: $(STAMP)  ## every example in a docstring
	$(BIN)/python -m pytest --doctest-modules mavdiag sitl_plant detector -p no:cacheprovider

docs: $(STAMP)  ## the documentation site in build/site, warnings as errors
	$(BIN)/sphinx-build -q -W --keep-going -b html docs build/site

examples: $(STAMP)  ## run the examples as they stand
	set -e; for example in examples/*.py; do echo "$$example"; $(BIN)/python $$example; done

screenshots: $(STAMP)  ## the pages of reports in Chromium, as pictures in build/screenshots
	PYTHONPATH=tests $(BIN)/python benchmarks/screenshots.py

older: $(STAMP)  ## the tests as on a processor that has nothing above AVX2; says so where this one has nothing more
	$(BIN)/nox -s older

lowest: $(STAMP)  ## the lowest versions that pyproject.toml allows, in an environment of their own
	$(BIN)/nox -s lowest

dist: $(STAMP)  ## wheel and sdist, checked and tried in a clean environment
	$(BIN)/nox -s packages

deb: dist  ## the Debian package, with all that it needs but Python
	deploy/debian/build

try-deb:  ## install the package, fly the emulator until an alert, remove it; root only
	deploy/debian/try

bench: $(STAMP)  ## the short benchmarks: ratios against a peer in the same run
	set -e; for script in start_time decode plant_speed chain_speed detector_load endpoint; do $(BIN)/python benchmarks/$$script.py; done

fuzz: $(STAMP)  ## hostile input: 10^7 datagrams, and 10 minutes guided by coverage (hours on a slow machine)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group fuzz
	PYTHONPATH=tests $(BIN)/python fuzz/datagrams.py
	PYTHONPATH=tests $(BIN)/python fuzz/atheris_link.py fuzz/corpus -max_total_time=600 -max_len=1024

soak: $(STAMP)  ## the daemon for hours: memory, latency, missed alerts
	PYTHONPATH=tests:fuzz $(BIN)/python benchmarks/soak.py virtual
	PYTHONPATH=tests:fuzz $(BIN)/python benchmarks/soak.py real

check: lint types layers doctest docs test examples  ## everything that CI runs

clean:  ## remove the environment and caches
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

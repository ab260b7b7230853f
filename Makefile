# Every target sets up what it needs: a fresh clone needs only make and Python 3.11 or newer.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
INSTALL := $(BIN)/uv pip install --quiet --python $(BIN)/python --constraint constraints.txt
# With it every process compiles all modules anew, for two seconds.
unexport PYTHONDONTWRITEBYTECODE
COMPILED := $(VENV)/.kernel $(VENV)/.rows $(VENV)/.plant

.PHONY: system demo test virtual realtime lint types layers doctest docs examples screenshots dist deb try-deb packages \
  check older bounds lowest bench fuzz soak clean help

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt uv
	$(INSTALL) --editable '.[fleet,web,history,mqtt,export]' --group test --group check --group site
	$(INSTALL) --no-deps MAVProxy==1.8.75
	@touch $@

# What judges and what flies is compiled once, in parts: `make -j2` uses two cores.
$(VENV)/.kernel: $(STAMP)
	$(BIN)/python -c 'from mavdiag.kernel import warm; warm()'
	@touch $@

$(VENV)/.rows: $(STAMP)
	$(BIN)/python -c 'from mavdiag.link import samples; from mavdiag.rows import front; front.warm(); samples.warm()'
	@touch $@

$(VENV)/.plant: $(STAMP)
	$(BIN)/sitl-plant record --duration 1 -o $(VENV)/warm.tlog
	@touch $@

# a vehicle as it was recorded has code of its own, which tests in two processes would compile twice
$(VENV)/.recorded: $(VENV)/.plant
	$(BIN)/sitl-plant record --duration 1 --vehicle qdrone2-recorded -o $(VENV)/warm.tlog
	@touch $@

system:  ## Chromium, Mosquitto, PostgreSQL and help2man for what uses them, where this may install them
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  command -v chromedriver >/dev/null && command -v /usr/sbin/mosquitto >/dev/null && command -v help2man >/dev/null && ls /usr/lib/postgresql/*/bin/postgres >/dev/null 2>&1 || \
	  { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends \
	    chromium chromium-driver fonts-dejavu-core mosquitto postgresql help2man; } >/dev/null 2>&1 || \
	  echo "system: not installed; the tests that need them are skipped"; \
	else echo "system: not root, or no apt-get; tests of what is missing are skipped"; fi

demo: $(COMPILED)  ## the main job: plant, detector and alert over MAVLink on loopback
	$(BIN)/mavdiag demo

test: virtual realtime  ## the whole test suite

virtual: $(COMPILED) $(VENV)/.recorded  ## the tests that need no wall clock, in the order of the files: those that take longest come first
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not realtime"

realtime: $(COMPILED)  ## those that need it, and the machine for themselves: they mostly wait
	$(BIN)/python -m pytest -n 4 --dist worksteal -m realtime $$(grep -rl --include='test_*.py' mark.realtime tests | sort)

lint: $(STAMP)  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)  ## mypy --strict
	$(BIN)/mypy

layers: $(STAMP)  ## the import contracts
	$(BIN)/lint-imports

doctest: $(COMPILED)  ## every example in a docstring
	PYTHONPATH=tests $(BIN)/python -m pytest -p conftest --doctest-modules mavdiag sitl_plant detector -p no:cacheprovider

docs: $(COMPILED)  ## the documentation site in build/site, warnings as errors
	$(BIN)/sphinx-build -q -W --keep-going -b html docs build/site

examples: $(COMPILED)  ## run the examples as they stand
	set -e; for example in examples/*.py; do echo "$$example"; $(BIN)/python $$example; done

screenshots: $(COMPILED)  ## the pages of reports in Chromium, as pictures in build/screenshots
	PYTHONPATH=tests $(BIN)/python benchmarks/screenshots.py

older: $(STAMP)  ## the tests as on a processor that has nothing above AVX2; says so where this one has nothing more
	$(BIN)/nox -s older

bounds: $(STAMP)  ## a core part of the tests with every index of compiled code checked
	$(BIN)/nox -s bounds

lowest: $(STAMP)  ## the lowest versions that pyproject.toml allows, in an environment of their own
	$(BIN)/nox -s lowest

dist: $(COMPILED)  ## wheel and sdist, checked and tried in a clean environment
	$(BIN)/nox -s packages

deb: dist  ## the Debian package, with all that it needs but Python
	deploy/debian/build

try-deb:  ## install the package, fly the emulator until an alert, remove it; root only
	deploy/debian/try

packages: dist  ## the packages built and tried, where this may install one
	if [ "$$(id -u)" = 0 ] && [ ! -e /opt/mavdiag ] && command -v dpkg-deb >/dev/null && command -v help2man >/dev/null; then \
	  DEB_PACKED=none deploy/debian/build && deploy/debian/try; \
	else echo "packages: no root, not Debian, or mavdiag is installed: its package is not built and tried"; fi

bench: $(COMPILED)  ## the short benchmarks: ratios against a peer in the same run
	set -e; for script in start_time decode plant_speed chain_speed detector_load endpoint; do $(BIN)/python benchmarks/$$script.py; done

fuzz: $(STAMP)  ## hostile input: 10^7 datagrams, 1,000 baselines, and 10 minutes guided by coverage (hours on a slow machine)
	$(INSTALL) --group fuzz
	PYTHONPATH=tests $(BIN)/python fuzz/datagrams.py
	$(BIN)/python fuzz/baselines.py
	PYTHONPATH=tests $(BIN)/python fuzz/atheris_link.py fuzz/corpus -max_total_time=600 -max_len=1024

soak: $(COMPILED)  ## the daemon for hours: memory, latency, missed alerts
	PYTHONPATH=tests:fuzz $(BIN)/python benchmarks/soak.py virtual
	PYTHONPATH=tests:fuzz $(BIN)/python benchmarks/soak.py real

check: lint types layers doctest docs test examples  ## everything that CI runs

clean:  ## remove the environment and caches
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

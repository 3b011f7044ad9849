# make demo    one cycle of the virtual support, measured; results in demo/
# make test    all tests
# make browser the live page and the report in a browser (Chromium must be installed)
# make screenshots  the pictures of page and report in docs/images (Chromium)
# make acceptance  the installed service on a real kernel: spidev, GPIO, SocketCAN, systemd (Debian 12, as root)
# make coverage  the same with branch coverage (half as fast)
# make check   ruff and mypy
# make bench   speed and accuracy figures; nothing is asserted
# make faults  what each fault does, as a table (two minutes)
# make docs    generate the references of configuration and fault scripts
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed

# Compiled modules are kept: without them each process compiles all tests anew.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test browser screenshots acceptance coverage check bench docs faults rebase clean

demo: $(INSTALLED)
	$(BIN)/ramstroke demo --out demo

# One process more than processors: many tests wait for real time. In their own order, the longest come first.
test: $(INSTALLED)
	$(BIN)/python -m pytest -n $$(($$(nproc) + 1)) --maxprocesses 4 --dist loadscope --no-loadscope-reorder

browser: $(INSTALLED)
	$(BIN)/python -m pytest tests/browser

screenshots: demo
	$(BIN)/ramstroke review demo/demo.mcap -o demo/report.html --methods kf2
	$(BIN)/python -m tests.browser.report_pages demo/report.html docs/images/report.png
	$(BIN)/python -m tests.browser.live_pictures

acceptance: $(INSTALLED)
	$(BIN)/python -m tests.acceptance.machine.acceptance

coverage: $(INSTALLED)
	$(BIN)/python -m pytest --cov --cov-report=term:skip-covered

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[bench]"
	$(BIN)/python -m tests.bench

docs: $(INSTALLED)
	$(BIN)/python -m daemon.configuration_reference > docs/configuration.md
	$(BIN)/python -m daemon.simulation.fault_reference > docs/faults.md

faults: $(INSTALLED)
	$(BIN)/python -m tests.fault_table > docs/outcomes.md

rebase: $(INSTALLED)
	$(BIN)/python -m pytest tests/acceptance/test_regression.py tests/acceptance/test_recorded_bytes.py --rebase

clean:
	rm -rf $(VENV) demo dist build .coverage .mypy_cache .ruff_cache .pytest_cache .hypothesis

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

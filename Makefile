# Two commands do everything on a fresh machine: `make sample` and `make test`.
PYTHON ?= python3
VENV := .venv
ifeq ($(OS),Windows_NT)
BIN := $(VENV)/Scripts
else
BIN := $(VENV)/bin
endif

.PHONY: sample test check docs clean

sample: $(VENV)/installed
	$(BIN)/georef run sample_project

test: $(VENV)/installed
	$(BIN)/python -m pytest -n auto --dist loadfile

check: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/installed
	$(BIN)/python docs/build_site.py

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	$(BIN)/python -c "open('$(VENV)/installed', 'w').close()"

clean:
	$(PYTHON) -c "import shutil; [shutil.rmtree(p, ignore_errors=True) for p in ('$(VENV)', 'sample_project/products', 'sample_project/cache', 'sample_project/navigation')]"
	$(PYTHON) -c "import pathlib; [f.unlink() for f in pathlib.Path('georef_gis').rglob('*.nb?')]"

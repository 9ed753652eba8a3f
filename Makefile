# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint nets clean
.DELETE_ON_ERROR:

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

$(VENV)/.nets: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[nets]'
	touch $@

## run the three garages, park every car and bring every car back, write the report
demo: $(STAMP)
	$(BIN)/parking-sim demo

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

test: lint $(VENV)/.nets
	$(BIN)/python -m pytest -n 2

## rebuild the committed nets from their layouts
nets: $(VENV)/.nets
	$(BIN)/parking-sim build-net --all

clean:
	rm -rf $(VENV) runs

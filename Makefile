# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint nets docs clean
.DELETE_ON_ERROR:

# --no-compile: most of what is installed is never imported
$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -e '.[dev]'
	touch $@

# netconvert for the nets; the tests use all extras
$(VENV)/.extras: $(STAMP)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -e '.[nets,cluster,tune]'
	touch $@

## run the three garages, park every car and bring every car back, write the report
demo: $(STAMP)
	$(BIN)/parking-sim demo

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

# the pages are tested in a real browser; where it can't be installed the tests say what to do
$(VENV)/.browser: $(STAMP)
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || \
	  { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq && \
	    apt-get install -y -qq --no-install-recommends chromium >/dev/null; } || \
	  echo "no Chromium: install it, or set PARKING_SIM_NO_BROWSER=1 to leave out the tests of pages"
	touch $@

test: lint $(VENV)/.extras $(VENV)/.browser
	$(BIN)/python -m pytest -n 2

## rebuild the committed nets from their layouts
nets: $(VENV)/.extras
	$(BIN)/parking-sim build-net --all

$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -e '.[docs]'
	touch $@

## build the docs site into build/docs
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) runs build

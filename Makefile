# Both targets do all their own set-up on a fresh machine with Python 3.11.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
RUN := $(VENV)/bin
# These look at the clock, as instruments and clients do: one after another, with the machine to themselves.
REAL_TIME := $(addprefix tests/,acquisition bench campaigns conformance drivers e2e service \
  sims/camera sims/process sims/projector sims/stage)

.PHONY: demo test check clean

demo: $(VENV)/demo.stamp
	$(RUN)/irpmd-rig demo

test: $(VENV)/dev.stamp
	$(RUN)/python -m pytest --numprocesses 2 --dist loadfile $(REAL_TIME:%=--ignore=%)
	$(RUN)/python -m pytest $(REAL_TIME)

check: $(VENV)/dev.stamp
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy
	$(RUN)/lint-imports

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# An editable installation: what is on disk is what is imported. The constraints are what was tested.
$(VENV)/demo.stamp: $(VENV)/bin/python pyproject.toml constraints.txt
	$(RUN)/python -m pip install --quiet --editable . --constraint constraints.txt
	@touch $@

$(VENV)/dev.stamp: $(VENV)/bin/python pyproject.toml constraints.txt
	$(RUN)/python -m pip install --quiet --editable '.[dev]' --constraint constraints.txt
	@touch $@ $(VENV)/demo.stamp

clean:
	rm -rf $(VENV) build dist demo *.egg-info

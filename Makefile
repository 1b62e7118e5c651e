# Both targets do all their own set-up on a fresh machine with Python 3.11.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
RUN := $(VENV)/bin
# These measure rates, or count what there is on the machine: one after another, with the machine to themselves.
ALONE := $(addprefix tests/,bench drivers/camera/test_camera_worker.py drivers/test_faults_and_leaks.py)
# More processes than the two cores that CI has: instruments and clients mostly wait.
PROCESSES := 3

.PHONY: demo test check clean

demo: $(VENV)/demo.stamp
	$(RUN)/irpmd-rig demo

test: $(VENV)/dev.stamp
	$(RUN)/python -m pytest --numprocesses $(PROCESSES) --dist loadfile $(ALONE:%=--ignore=%)
	$(RUN)/python -m pytest $(ALONE)

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

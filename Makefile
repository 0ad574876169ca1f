# The whole interface of a developer: `make demo`, `make test`, `make lint`, `make docs`, `make mutants`, `make install`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# One thread per process: on small or busy machines more OpenMP threads make small tensors slower, not faster.
export OMP_NUM_THREADS ?= 1

.PHONY: install demo test lint docs mutants clean

install: $(VENV)/installed

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[test]"
	touch $@

demo: install
	$(BIN)/python baselines/demo.py

# One process per core, at most four: every one compiles or loads its kernels.
test: install
	$(BIN)/python -m pytest -m "not slow and not browser and not release and not external" -n auto --maxprocesses 4 --dist worksteal

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# Replays of the tasks and the shipped checkpoints, pages that follow from committed measurements (benchmarks and studies write
# those), and the site, in build/site/html.
docs: install
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[docs]"
	$(BIN)/python -m tools.docs.replays
	$(BIN)/python -m tools.docs
	$(BIN)/python -m tools.docs.site

# Changes to the program that tests must notice, and whether they do.
mutants: install
	$(BIN)/python tools/mutants.py

clean:
	rm -rf $(VENV) runs

# Every target needs only Python ≥ 3.11, pip and make, and sets up .venv once.
PYTHON ?= python3
BIN := .venv/bin
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export HYPOTHESIS_PROFILE ?= ci

.PHONY: train test bench notebooks mutants clean

train: .venv/train
	$(BIN)/python -m gbdqn_ref compare --env cartpole --preset fast --out runs/cartpole

test: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest

bench: .venv/train
	$(BIN)/python benchmarks/bench.py --out runs/bench.png

notebooks: .venv/test
	$(BIN)/python notebooks/render.py

mutants: .venv/test
	$(BIN)/pip install --quiet --editable '.[dev,mutants]'
	$(BIN)/python tests/mutants.py

.venv/train: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable .
	touch $@

.venv/test: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable '.[dev]'
	touch $@ .venv/train

clean:
	rm -rf .venv runs mutants

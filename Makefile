# Every target needs only Python ≥ 3.11, pip and make, and sets up .venv once.
PYTHON ?= python3
BIN := .venv/bin
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export HYPOTHESIS_PROFILE ?= ci

.PHONY: train test site test-site bench notebooks mutants plant test-oldest clean

train: .venv/train
	$(BIN)/python -m gbdqn_ref study --env acrobot-recurring --agents dqn,gbdqn,dqn-reuse,gbdqn-reuse \
		--seeds 2 --jobs 2 --set episodes=350 --out runs/reversed

test: .venv/site
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile

site: .venv/site
	$(BIN)/python site/build.py

# In the system's Chromium or Chrome; what needs one is skipped where there is none.
test-site: .venv/site-test
	$(BIN)/python -m pytest tests/test_site.py tests/test_figures.py

bench: .venv/train
	$(BIN)/python benchmarks/bench.py --out runs/bench.png

notebooks: .venv/test
	$(BIN)/python notebooks/render.py

mutants: .venv/test
	$(BIN)/pip install --quiet --editable '.[dev,mutants]'
	$(BIN)/python tests/mutants.py

plant: .venv/test
	$(BIN)/python paper_checks/plant.py

# Without the notebooks. Python's own lower bound: make test-oldest PYTHON=python3.11
test-oldest: .venv-oldest/test
	.venv-oldest/bin/python -m pytest --ignore tests/test_notebooks.py

.venv/train: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable .
	touch $@

.venv/test: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable '.[dev]'
	touch $@ .venv/train

.venv/site: .venv/test
	$(BIN)/pip install --quiet --editable '.[dev,site]'
	touch $@

.venv/site-test: .venv/site
	$(BIN)/pip install --quiet --editable '.[dev,site,site-test]'
	touch $@

.venv-oldest/test: pyproject.toml
	$(PYTHON) -m venv .venv-oldest
	$(PYTHON) -c 'import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
		print("\n".join(project["dependencies"]).replace(">=", "=="))' > .venv-oldest/bounds.txt
	.venv-oldest/bin/pip install --quiet --editable '.[dev]' --requirement .venv-oldest/bounds.txt
	touch $@

clean:
	rm -rf .venv .venv-oldest runs mutants site/_build

# Each target sets up what it needs; `make demo` and `make test` are all a newcomer types.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
EXTRAS := dev,console,realsense,fast
OTHER_VENV := .venv-opencv5
OTHER_STAMP := $(OTHER_VENV)/.ready
PROOF_VENV := .venv-proof
PROOF_STAMP := $(PROOF_VENV)/.ready
LOADERS_VENV := .venv-loaders
LOADERS_STAMP := $(LOADERS_VENV)/.ready
# Ultralytics (AGPL-3.0) is asked here and nowhere else, and without its own OpenCV, which would overwrite ours.
LOADERS := torch==2.14.1 torchvision==0.29.1 matplotlib requests scipy polars
# Pinned: another version trains otherwise. PyPI's PyTorch for Linux brings CUDA along (6 GB), though only the CPU is used.
TRAINER := libreyolo==1.6.0 torch==2.14.1 torchvision==0.29.1
# Compiled modules are kept, whatever the environment says: each service starts in two thirds of the time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo run test test-long fuzz lint bench proof docs clean
.DEFAULT_GOAL := help

help: ## what there is
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

$(STAMP): pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "tagmill needs Python 3.11 or newer; '$(PYTHON)' is older. Name another: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --constraint requirements.lock --editable '.[$(EXTRAS)]'
	@touch $@

setup: $(STAMP) ## make .venv with everything that the other targets need

demo: $(STAMP) ## record 24 samples from two synthetic cameras and show the table against the truth
	$(BIN)/python -m tools.demo

run: $(STAMP) ## start the stack with the rig of RIG=... (default: the synthetic example)
	$(BIN)/tagmill up --rig $(or $(RIG),deploy/examples/synthetic.yaml)

test: $(STAMP) ## everything but the long runs (under 10 minutes on 2 cores)
	$(BIN)/python -m pytest -m 'not long' -n 4

test-long: $(STAMP) $(OTHER_STAMP) $(LOADERS_STAMP) ## the long runs, all others on OpenCV 5, and those that ask others' loaders
	$(BIN)/python -m pytest -m 'long and not loaders' -n 2
	$(LOADERS_VENV)/bin/python -m pytest -m loaders tests/loaders
	$(OTHER_VENV)/bin/python -m pytest -m 'not long' -n 2

$(OTHER_STAMP): pyproject.toml requirements.lock
	$(PYTHON) -m venv $(OTHER_VENV)
	$(OTHER_VENV)/bin/pip install --quiet --upgrade pip
	grep -v '^opencv' requirements.lock > $(OTHER_VENV)/requirements.lock
	$(OTHER_VENV)/bin/pip install --quiet --constraint $(OTHER_VENV)/requirements.lock --editable '.[$(EXTRAS)]' 'opencv-contrib-python-headless>=5,<6'
	@touch $@

$(LOADERS_STAMP): pyproject.toml requirements.lock
	$(PYTHON) -m venv $(LOADERS_VENV)
	$(LOADERS_VENV)/bin/pip install --quiet --upgrade pip
	$(LOADERS_VENV)/bin/pip install --quiet --constraint requirements.lock --editable '.[dev,check,view]' $(LOADERS)
	$(LOADERS_VENV)/bin/pip install --quiet --no-deps 'ultralytics>=8.4,<9'
	@touch $@

fuzz: $(STAMP) ## hostile input for every parser, SECONDS=60 each, led by coverage (atheris, Python 3.11 to 3.13)
	$(BIN)/pip install --quiet --constraint requirements.lock atheris
	$(BIN)/python -m tests.fuzz.run --seconds $(or $(SECONDS),60)

lint: $(STAMP) ## ruff, mypy strict, import-linter
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check --no-cache .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP) ## load test: four synthetic cameras through the real stack
	$(BIN)/tagmill bench load --cameras 4 --fps 30 --size 1280x720 --seconds 30

proof: $(STAMP) $(PROOF_STAMP) ## train a small detector on marker-free, erased and raw pictures and compare (20 minutes, 6 GB)
	$(BIN)/python -m tools.proof --trainer $(PROOF_VENV)/bin/python

$(PROOF_STAMP):
	$(PYTHON) -m venv $(PROOF_VENV)
	$(PROOF_VENV)/bin/pip install --quiet --upgrade pip
	$(PROOF_VENV)/bin/pip install --quiet $(TRAINER)
	@touch $@

docs: $(STAMP) ## write the generated pages (topics, command socket, label schema)
	$(BIN)/python -m tools.docs

clean: ## remove what the targets made
	rm -rf $(VENV) $(OTHER_VENV) $(LOADERS_VENV) $(PROOF_VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache demo-out proof-out

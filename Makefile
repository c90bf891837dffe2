# Everything a reader needs, with only Python (3.11 or newer), git and make installed:
#   make table2   set up a virtual environment and make Table 2 on built-in data
#   make test     style, types, tests and notebooks
#   make help     all targets
# All paths are relative, so the checkout may lie anywhere. Another interpreter: make PYTHON=python3.12 setup

PYTHON ?= python3
VENV ?= .venv
OUTPUT ?= runs/notebooks/table2_ablation.ipynb
# Passed on to papermill, e.g. PARAMETERS="-p categories car -p seeds 3"
PARAMETERS ?=
# make image WHEELS=cuda BUILDER=podman BUILD_OPTIONS="--build-arg BASE=..."
WHEELS ?= cpu
BUILDER ?= $(firstword $(foreach each,docker podman buildah,$(if $(shell command -v $(each)),$(each))))
BUILD_OPTIONS ?=
# make lock UPGRADE=--upgrade takes the newest versions; without it, pins change only where they have to.
UPGRADE ?=

RUN := $(VENV)/bin/python -m
PIP := $(RUN) pip install --disable-pip-version-check --quiet
# An environment is ours where one of the stamps below is in it. Others, and what links lead to, stay as they are.
OURS := [ ! -L "$(VENV:%/=%)" ] && { [ -e "$(VENV)/.locked" ] || [ -e "$(VENV)/.installed" ]; }
INSTEAD := or make VENV=other $(or $(MAKECMDGOALS),setup)
UNLINKED := [ ! -L "$(VENV:%/=%)" ] || { echo "make: $(VENV) is a symbolic link: remove it, $(INSTEAD)" >&2; exit 1; }
# Pages whose tables and numbers are rendered from paper_tables/ by docs/measured.py
PAGES := README.md $(wildcard docs/*.md)
NOTEBOOK := $(VENV)/bin/viewnet notebook
COG := $(RUN) cogapp -P -I docs -p "from measured import *" --verbosity=1
.DEFAULT_GOAL := help
.PHONY: help setup table2 replication test test-fast style lint format numbers notebooks docs web image lock clean

help: ## list the targets
	@sed -n 's/^\([a-z0-9-]*\):.*## /\1\t/p' Makefile | expand -t 12

setup: $(VENV)/.installed ## make the virtual environment from environment.lock

# Two stamps: the libraries are installed anew when the lock changes, the package itself when its metadata does.
$(VENV)/.locked: environment.lock
	@command -v "$(PYTHON)" >/dev/null || { \
	  echo "make: no $(PYTHON) here: install Python 3.11 or newer, or name one: make PYTHON=python3.12 ..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "make: $$("$(PYTHON)" --version) is too old: 3.11 or newer is needed: make PYTHON=python3.12 ..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "make: $(PYTHON) cannot make virtual environments: install python3-venv (Debian, Ubuntu)" >&2; exit 1; }
	@$(UNLINKED)
	@[ -z "$$(ls -A "$(VENV)" 2>/dev/null)" ] || { $(OURS); } || { \
	  echo "make: $(VENV) was not made by make, which leaves it as it is: remove it, $(INSTEAD)" >&2; exit 1; }
	@[ -z "$$(ls -A "$(VENV)" 2>/dev/null)" ] || [ "$(filter setup,$(MAKECMDGOALS))" ] || { \
	  echo "make: $(VENV) is not as environment.lock says: make setup makes it anew" >&2; exit 1; }
	@rm -rf "$(VENV)" && mkdir -p "$(VENV)" && touch -t 200001010000 $@  # ours, also where this is interrupted
	"$(PYTHON)" -m venv "$(VENV)"
	@echo "installing what environment.lock lists: several GB to download, PyTorch's CUDA libraries among them"
	@sed -n '/^uv==/,/^    # via/p' environment.lock >"$(VENV)/uv.txt"
	$(PIP) --no-compile --require-hashes -r "$(VENV)/uv.txt" \
	  && "$(VENV)/bin/uv" pip install --system-certs --quiet --python "$(VENV)" --require-hashes -r environment.lock \
	  || { echo "uv could not, for the reason above: pip installs instead, which takes longer"; \
	    $(PIP) --no-compile --require-hashes -r environment.lock; }
	@touch $@

$(VENV)/.installed: $(VENV)/.locked pyproject.toml
	@$(UNLINKED)
	$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

table2: setup ## Table 2 on built-in data, trained here where it is missing
	@mkdir -p "$(dir $(OUTPUT))"
	$(RUN) papermill notebooks/table2_ablation.ipynb "$(OUTPUT)" $(PARAMETERS)
	@echo "the executed notebook: $(OUTPUT)"

replication: setup ## every training behind the tables, kept in paper_tables/; stop and start it at will
	$(VENV)/bin/viewnet replicate

test: style ## style, types, all tests and every notebook; what else lint checks is among the tests
	OMP_NUM_THREADS=1 $(RUN) pytest --nbval -n auto --maxprocesses 2 --dist loadfile --no-loadscope-reorder

test-fast: setup ## the tests that take seconds, without notebooks
	OMP_NUM_THREADS=1 $(RUN) pytest tests -m "not slow" -q -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

style: setup ## style and types
	$(RUN) ruff check
	$(RUN) ruff format --check
	$(RUN) mypy

lint: style ## style, types, imports between rooms, numbers in the documents, form of notebooks
	$(VENV)/bin/lint-imports
	$(COG) --check --check-fail-msg="not as in paper_tables/: run make numbers" $(PAGES)
	$(RUN) pytest -q tests/experiments/test_notebooks.py -k TestForm

format: setup ## mend the style where that can be done by a tool
	$(RUN) ruff check --fix
	$(RUN) ruff format

numbers: setup ## render the numbers in the documents anew from paper_tables/
	$(COG) -r $(PAGES)

notebooks: setup ## parameters of the notebooks, and what they show of paper_tables/, stored anew; trains nothing
	$(NOTEBOOK) all --refresh

docs: setup ## the pages and the reference of every module as HTML: build/docs/index.html
	$(VENV)/bin/python docs/build.py build/docs
	@echo "the first page: build/docs/index.html"

web: setup ## a page that needs no server, for any static host: build/web; needs npm
	$(VENV)/bin/python web/build.py build/web
	@echo "to look at it: $(VENV)/bin/python -m http.server --directory build/web"

image: ## an image for containers, by docker, podman or buildah; with CUDA: make image WHEELS=cuda
	@[ -n "$(BUILDER)" ] || { echo "make: no docker, podman or buildah here: install one of them" >&2; exit 1; }
	$(BUILDER) build --file Containerfile --build-arg WHEELS=$(WHEELS) --tag viewnet:$(WHEELS) $(BUILD_OPTIONS) .

lock: ## pin every dependency anew in environment.lock
	"$(PYTHON)" -m venv build/uv
	build/uv/bin/python -m pip install --disable-pip-version-check --quiet uv
	UV_CUSTOM_COMPILE_COMMAND="make lock" build/uv/bin/uv pip compile pyproject.toml --extra test --universal \
	  --python-version 3.11 --generate-hashes --quiet $(UPGRADE) --output-file environment.lock

clean: ## remove the virtual environment and caches; data and runs stay
	@if $(OURS); then rm -rf "$(VENV)"; elif [ -e "$(VENV)" ]; then echo "make: $(VENV) stays: not made by make"; fi
	rm -rf build .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis *.egg-info
	find viewnet tests notebooks -name __pycache__ -type d -prune -exec rm -rf {} +

# Needs GNU make and Python 3.10 or newer with its venv module, nothing else.
# `make help` lists the targets; PYTHON=python3.12 chooses an interpreter.

PYTHON ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/installed

LOCK_ARGS ?=

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

.PHONY: help
help: ## List the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1|\2/p' Makefile | awk -F'|' '{ printf "%-22s %s\n", $$1, $$2 }'

.PHONY: setup
setup: $(STAMP) ## Make .venv with the locked dependencies and the package

$(STAMP): requirements.lock pyproject.toml
	@PYTHON='$(PYTHON)' sh tools/make-venv $(VENV)
	@echo 'Installing the locked dependencies into $(VENV). This is done once and takes some minutes.'
	@sh tools/install-lock $(BIN)/python requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $@

.PHONY: demo
demo: setup ## Plan the paper's example; figures and an animation go to out/
	@$(BIN)/python examples/paper_demo.py

# Tests start Python some hundred times: compiled modules are kept, whatever the
# environment says.
test test-all: export PYTHONDONTWRITEBYTECODE =

# On all cores, whole files each: what a file plans once serves all its tests.
PYTEST_ARGS ?= -n auto --dist loadfile

.PHONY: test
test: setup ## Run the tests (PYTEST_ARGS="-k lp -x" to choose)
	@$(BIN)/python -m pytest $(PYTEST_ARGS)

.PHONY: test-all
test-all: setup ## Run all tests, with those that take minutes
	@$(BIN)/python -m pytest -m 'nightly or not nightly' $(PYTEST_ARGS)

.PHONY: check
check: lint types layers house spelling ## Lint, formatting, types, import layers, budget, spelling

.PHONY: lint
lint: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check

.PHONY: types
types: setup
	$(BIN)/mypy
	$(BIN)/python tools/type_check_documents.py

.PHONY: layers
layers: setup
	$(BIN)/lint-imports --no-logo

.PHONY: house
house: setup ## Code lines by room, held against their budget
	@$(BIN)/python tools/house.py

.PHONY: house-lower
house-lower: setup ## Take off the budget what a change has saved
	@$(BIN)/python tools/house.py --lower

.PHONY: spelling
spelling: setup
	$(BIN)/codespell

.PHONY: format
format: setup ## Put the code into the project's format
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

.PHONY: bench
bench: setup ## Run the benchmarks with their default options, as far as these suffice
	@for script in $(notdir $(basename $(wildcard benchmarks/[a-z]*.py))); do \
	    echo "benchmarks.$$script"; \
	    $(BIN)/python -m "benchmarks.$$script" || echo "benchmarks.$$script: exit code $$?"; \
	done

.PHONY: package-check
package-check: setup ## Build wheel and sdist, install and try them in an empty environment
	@$(BIN)/python tools/check_package.py

.PHONY: documents-check
documents-check: setup ## Run what README and the first pages show, with the wheel only
	@$(BIN)/python tools/check_package.py --documents

DOCS_STAMP := $(VENV)/docs-installed

# Beside the dependencies of the package, at the same versions where both want one.
$(DOCS_STAMP): $(STAMP) docs/requirements.lock
	@sh tools/install-lock $(BIN)/python docs/requirements.lock
	@touch $@

.PHONY: docs
docs: $(DOCS_STAMP) ## Build the documentation: docs/build/html; runs its notebooks, checks its links
	@$(BIN)/python tools/doc_blocks.py --slow
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/build/html
	@echo 'docs/build/html/index.html'

.PHONY: docs-links
docs-links: $(DOCS_STAMP) ## Check the links to the world; needs a network
	@$(BIN)/python -m sphinx -q -b linkcheck docs docs/build/links

.PHONY: lock
lock: ## Resolve the dependencies anew (LOCK_ARGS=--upgrade for newer releases)
	@PYTHON='$(PYTHON)' sh tools/make-venv .venv-lock
	@.venv-lock/bin/python -m pip install --quiet --disable-pip-version-check 'uv>=0.5.3'
	UV_CUSTOM_COMPILE_COMMAND='make lock' .venv-lock/bin/uv pip compile pyproject.toml \
	    --extra plots --group dev \
	    --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	    --no-strip-extras --quiet $(LOCK_ARGS) --output-file requirements.lock
	UV_CUSTOM_COMPILE_COMMAND='make lock' .venv-lock/bin/uv pip compile pyproject.toml \
	    --group docs --constraint requirements.lock \
	    --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	    --no-strip-extras --quiet $(LOCK_ARGS) --output-file docs/requirements.lock

.PHONY: clean
clean: ## Remove what was built and written: out/, dist/, caches
	rm -rf build dist docs/build out .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find benchmarks examples src tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

.PHONY: distclean
distclean: clean ## As clean, and remove the environments too
	rm -rf $(VENV) .venv-lock

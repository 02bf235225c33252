# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: help setup demo demo-web test suite test-fast lint format pictures docs clean

help: ## Shows what there is.
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(READY) ## Makes the environment in .venv.

$(READY): pyproject.toml constraints.txt scripts/venv.sh scripts/links.sh
	@PYTHON="$(PYTHON)" sh scripts/venv.sh "$(VENV)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@sh scripts/links.sh $(VENV)/src
	@$(BIN)/python -c 'import fleetpose.pose_server.registration.align'
	@touch $@

demo: $(READY) ## Six robots around a building find each other; q ends it.
	@$(BIN)/python -m fleetpose.evaluation demo

demo-web: $(READY) ## The same with the operator's page in a browser; Ctrl-C ends it.
	@$(BIN)/python -m fleetpose.evaluation demo --web

test: $(READY) ## Lint, types, import rules and all tests; the first three beside the last.
	@$(MAKE) --no-print-directory -j2 lint suite

suite: $(READY)
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-fast: $(READY) ## What needs neither network nor recordings: under a minute.
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow"

lint: $(READY) ## ruff, pyright and the import rules.
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/pyright --pythonpath $(BIN)/python
	@sh scripts/links.sh -c $(VENV)/lint
	@PYTHONPATH=$(VENV)/lint $(BIN)/lint-imports --no-cache

format: $(READY) ## Formats the code.
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

pictures: $(VENV)/.docs ## Makes the pictures in docs/ anew, from the demo.
	@mkdir -p out/pictures
	@$(BIN)/python -m fleetpose.evaluation demo --pictures out/pictures
	@$(BIN)/python scripts/pictures.py out/pictures docs

docs: $(VENV)/.docs ## Builds the site of docs/ in out/site; a link that leads nowhere ends it.
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --clean

$(VENV)/.docs: $(READY)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

clean: ## Removes the environment and what tools leave.
	rm -rf $(VENV) build dist out/site *.egg-info .pytest_cache .ruff_cache .hypothesis

# `make demo` and `make test` do everything on a machine with git, make and Python 3.11.
# PyBullet ships wheels up to CPython 3.11 and needs a C++ compiler on newer ones, so 3.11 is asked for first.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Tests whose assertions pytest has rewritten, and modules that Python has compiled, are kept for the next process.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test pytest test-all test-part docs docs-notebooks docs-figures bench models check clean

demo: .venv/base
	@test -e .venv/compiled || test -e .venv/compiled-line || { \
		echo "compiling what the run needs, once"; $(BIN)/python -m scenes.compiled line && touch .venv/compiled-line; }
	$(BIN)/ideal-robot run line --out out/line
	@echo "open out/line/report.html in a browser"

# What does not start the program is checked beside the tests, which wait for other processes now and then.
test: .venv/installed
	$(MAKE) -j 2 check pytest

pytest: .venv/installed
	$(BIN)/pytest -n 2 --dist worksteal

test-all: .venv/installed check
	$(BIN)/pytest -n 2 --dist worksteal -m "not real_time"
	$(BIN)/pytest -m real_time

# One in twenty of the slow tests, others with the next commit; two minutes at most (124), none is no failure (5).
# Those in real time are for a computer that does nothing else.
test-part: .venv/installed
	timeout 120 $(BIN)/pytest -n 2 -m "slow and not real_time" --part $$(git rev-list --count HEAD 2>/dev/null || echo 0)/20; \
		s=$$?; test $$s -eq 0 -o $$s -eq 5 -o $$s -eq 124

# With the notebooks' outputs: those that changed since they were played last are played.
docs: .venv/installed docs-notebooks
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "open out/site/index.html in a browser"

# Minutes for all of them.
docs-notebooks: .venv/installed
	$(BIN)/python docs/execute_notebooks.py

docs-figures: .venv/installed
	$(BIN)/python docs/published_numbers.py

bench: .venv/installed
	for s in speed line-cycles cycle planning growth; do echo "== $$s"; $(BIN)/python -m studies $$s || exit 1; done

models: .venv/installed
	$(BIN)/python -m scenes.models

check: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

# What runs need; the rest, for tests, documentation and the viewer, comes with the first target that asks for it.
.venv/base: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "ideal-robot needs Python 3.11 (python3.11 on the PATH; on newer ones also a C++ compiler for PyBullet): none was found."; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing the program and its $$(sed -n '/^dependencies/,/^]/p' pyproject.toml | grep -c '"') libraries into .venv"
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
	touch $@

# Downloading waits for the network and compiling for the processor: side by side.
.venv/installed: .venv/base
	@echo "installing what tests, documentation and viewer need, compiling everything meanwhile"
	$(MAKE) -j 2 .venv/extras .venv/compiled
	touch $@

.venv/extras: .venv/base
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev,docs,view,cluster]'
	touch $@

.venv/compiled: .venv/base
	$(BIN)/python -m scenes.compiled
	touch $@

clean:
	rm -rf .venv out build *.egg-info

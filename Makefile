# Two commands on a bare machine with Python 3.11, make and Mesa's EGL:
#   make figures   runs the main job       make test   runs the checks and the tests
PYTHON ?= python3
OUT ?= runs/paper
BIN := .venv/bin

.PHONY: figures test clean

figures: .venv/installed
	$(BIN)/vergence reproduce --out $(OUT)

test: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/pytest -n auto --dist worksteal

# The stamp makes a second call instant, and a changed pyproject.toml install again.
.venv/installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@

clean:
	rm -rf .venv runs

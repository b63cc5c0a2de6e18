# On a bare machine with Python 3.11, make and Mesa's EGL:
#   make figures   runs the main job          make test   runs all checks and all tests
#   make view      opens its first recording  make check  runs the checks and the unit tests
#   make docs      builds the site
PYTHON ?= python3
OUT ?= runs/paper
BIN := .venv/bin

# Python keeps its bytecode even where the environment forbids it: else each of the many processes
# would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE
# More room for young objects saves the type checker a seventh of its time.
export NODE_OPTIONS = --max-semi-space-size=128

.PHONY: figures view test check docs clean

figures: .venv/installed
	$(BIN)/vergence reproduce --out $(OUT)

view:
	@test -e $(OUT)/fig06.rrd && test -x $(BIN)/rerun || { \
		echo "There is no $(OUT)/fig06.rrd yet; make it with: make figures OUT=$(OUT)"; exit 1; }
	$(BIN)/rerun $(OUT)/fig06.rrd

check: CHOSEN := -m "not render and not slow"
test check: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright & types=$$!; \
	$(BIN)/pytest -n auto --dist loadfile $(CHOSEN); tests=$$?; \
	wait $$types && exit $$tests

docs: .venv/installed-docs
	$(BIN)/python docs/site_pages.py site/pages
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -c docs site/pages site/html
	@echo "The site begins at site/html/index.html."

# The stamps make a second call instant, and a changed pyproject.toml install again. What is never
# imported, which is most of what is installed, need not be compiled.
.venv/installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[dev]"
	touch $@

.venv/installed-docs: .venv/installed
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[docs]"
	touch $@

clean:
	rm -rf .venv runs site

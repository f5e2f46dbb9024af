# Every target does its own set-up: system libraries (by apt when root), a virtual environment, the package.
VENV ?= .venv
PYTHON ?= python3
DEMO ?= # more options for `make demo`, such as DEMO='--seconds 2'
# processes that run tests: one more than cores, as some tests wait
JOBS ?= 3
USER_THERE ?= newbie
EVALUATE ?= # more options for `make evaluate`, such as EVALUATE=--quick
BIN := $(VENV)/bin

.PHONY: demo test check install style types fresh goldens bench report docs evaluate clean

demo: $(VENV)/.run
	$(BIN)/glsplat demo -o out/demo $(DEMO)

# style, types, and the tests that prove the core: minutes, with no more system packages than the demo
test: style types
	$(BIN)/pytest -m "not check" --numprocesses $(JOBS) --dist worksteal

# every test, with more Hypothesis examples; wants a browser, a virtual display and other drivers
check: $(VENV)/.dev style types
	HYPOTHESIS_PROFILE=check $(BIN)/pytest --numprocesses $(JOBS) --dist worksteal

install: $(VENV)/.run

style: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.test
	$(BIN)/mypy --num-workers 2

# the same on a bare Debian of its own making, as a newcomer (USER_THERE=root: as root); needs root
fresh:
	.ci/fresh $(USER_THERE)

# only after a change that is meant to change pictures: look at each one, give the reason in the commit message
goldens: $(VENV)/.test
	$(BIN)/pytest tests/golden --update-goldens

bench: $(VENV)/.run
	$(BIN)/glsplat bench

$(VENV)/.run: pyproject.toml .ci/system
	PYTHON=$(PYTHON) .ci/system
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/.test: $(VENV)/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	touch $@

$(VENV)/.dev: $(VENV)/.test
	PYTHON=$(PYTHON) .ci/system check
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

report: $(VENV)/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[report]'
	$(BIN)/glsplat report -o out/report

# The site of docs/ and the docstrings: open out/site/index.html, no server is needed; any fault ends it. The picture of
# the architecture and the copies of measured tables are made from the code and the tables first. The variable keeps a
# note on mkdocs-material's successor out of the log; --quiet would keep --strict from seeing faults.
docs: $(VENV)/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	$(BIN)/python -m tests.house
	$(BIN)/python -m tools.docs.measured --copies
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=. $(BIN)/mkdocs build --strict

# PARTICIPANTS=DIR are people of your own; EVALUATE='--quick' and the like are passed on
evaluate: $(VENV)/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[evaluate]'
	$(BIN)/glsplat models get --all
	$(BIN)/glsplat evaluate $(if $(PARTICIPANTS),--participants $(PARTICIPANTS)) -o out/evaluation $(EVALUATE)

clean:
	rm -rf $(VENV) build dist out *.egg-info

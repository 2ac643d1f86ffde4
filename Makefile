PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo setup lint test test-all gauntlet gauntlet-full docs reproduce bench study release pins clean

setup: .venv/.ready

.venv/.ready: pins.txt pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --require-hashes -r pins.txt
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation -e .
	touch $@

# The main job on logs that it makes itself: a model with its report, into build/demo.
demo: setup
	rm -rf build/demo && mkdir -p build/demo
	$(BIN)/hitchid bench build/demo/logs
	$(BIN)/hitchid identify build/demo/logs --out build/demo/model
	$(BIN)/hitchid validate build/demo/model build/demo/logs --out build/demo/results

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

test: setup lint
	$(BIN)/python -m pytest -m "not long" -n 2 --dist worksteal --durations 20

# What `make test` leaves out, and its tests by examples again, with more of them.
test-all: setup
	HITCHID_EXAMPLES=full $(BIN)/python -m pytest -m "long or hypothesis" -n 2 --dist worksteal --durations 20

gauntlet: setup
	$(BIN)/python -m benchmarks.gauntlet
	$(BIN)/python -m benchmarks.hmi
	$(BIN)/python -m benchmarks.adaptation quick
	$(BIN)/python -m benchmarks.fleet_outliers
	$(BIN)/python -m benchmarks.fleet quick

gauntlet-full: setup
	$(BIN)/python -m benchmarks.gauntlet --full

docs: setup
	$(BIN)/python -m tools.site

reproduce: setup
	$(BIN)/hitchid reproduce --out build/reproduce --force

bench: setup
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -r benchmarks/peers.txt
	rm -rf build/speed && mkdir -p build/speed
	$(BIN)/python -m pytest benchmarks/speed --benchmark-json build/speed/calls.json --timings build/speed/whole.json
	$(BIN)/python benchmarks/speed/page.py build/speed/calls.json build/speed/whole.json benchmarks/results.md

study: setup
	$(BIN)/python benchmarks/study.py
	$(BIN)/python benchmarks/coverage.py
	$(BIN)/python benchmarks/load_scatter.py
	$(BIN)/python benchmarks/bands.py
	$(BIN)/python benchmarks/advice.py
	$(BIN)/python benchmarks/fuzz.py
	$(BIN)/python benchmarks/resume.py
	$(BIN)/python -m benchmarks.position_control --draws 200
	$(BIN)/python -m benchmarks.export
	$(BIN)/python -m benchmarks.hmi --minutes 60
	$(BIN)/python -m benchmarks.fleet same killed study 1000
	$(BIN)/python -m benchmarks.adaptation

# Builds sdist and wheel twice, tries them in fresh environments of every Python found, with SBOM and hashes, into dist/.
release: setup
	$(BIN)/python -m tools.release

# For maintainers; needs uv in PATH.
pins:
	uv pip compile --universal --python-version 3.11 --fork-strategy fewest --upgrade \
		--generate-hashes --no-header --no-annotate --no-emit-index-url --no-emit-find-links \
		--quiet --group dev --output-file pins.txt pyproject.toml

clean:
	rm -rf .venv build dist .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

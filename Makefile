# Everything here works on a fresh clone with Python 3.11+, g++ and CMake; without the last two the NumPy twins run.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
NATIVE := $(wildcard processing/kernels/*.cpp processing/kernels/parts/*.?pp sim/*.cpp sim/*.hpp native/lfrig/*.hpp)
PYTEST_ARGS ?= -n 2

.PHONY: install demo pictures test lint gate bench wheel arm64 vectors clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt CMakeLists.txt $(NATIVE)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@

demo: $(STAMP)
	$(BIN)/lfrig demo --out demo --overwrite

pictures: demo
	$(BIN)/python docs/pictures/make.py demo/session/results/*

test: $(STAMP)
	$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	PYTHONPATH=.types $(BIN)/lint-imports

gate: $(STAMP)
	$(BIN)/lfrig bench regression --check --out out/gate

bench: $(STAMP)
	$(BIN)/lfrig bench accuracy --out out/bench
	$(BIN)/lfrig bench pareto --out out/bench
	$(BIN)/lfrig bench stress --out out/bench
	$(BIN)/lfrig bench decode --size full --out out/bench
	$(BIN)/lfrig bench kernels --out out/bench
	$(BIN)/lfrig bench skip --out out/bench

wheel: $(STAMP)
	rm -rf dist
	$(BIN)/python -m build --wheel --outdir dist .
	.ci/wheel-smoke dist/*.whl constraints.txt

# The native core on other processors, emulated: apt-get install g++-aarch64-linux-gnu qemu-user-static
arm64: $(STAMP)
	.ci/arm64 $(BIN)/python

vectors: $(STAMP)
	.ci/vector-levels $(BIN)/python

clean:
	rm -rf $(VENV) build dist demo out .*_cache

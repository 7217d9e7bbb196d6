# Needs Python 3.11 or newer and make; everything else goes into .venv.

PYTHON ?= python3
BIN := .venv/bin
# Three processes on two cores, for tests of the service often wait; each runs whole files with one thread.
# In the order of the folders: the files with the most tests, which xdist starts with, are not the longest.
# Byte code is kept whatever the environment says: the tests start a hundred processes.
PYTEST := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

.PHONY: setup demo serve test test-long test-all lint tables measured plasmodes bench warm load large-bodies chaos bench-dask bench-free-run bench-tape bench-written bench-continuous bench-busy-cores

setup: .venv/ready

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -m engine.compile_kernels
	touch $@

demo: setup
	$(BIN)/python -m service.demo

serve: setup
	$(BIN)/python -m service

# python -m puts this folder on the path, so that worker processes can import the test modules.
test: setup
	$(PYTEST) -m "not slow and not long"

# What takes a third of a second or more each, which every push is checked with as well.
test-long: setup
	$(PYTEST) -m "long and not slow"

test-all: setup
	$(PYTEST)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Every table and figure of the source documents at full size: about three hours on two cores,
# resumable; a short version: make tables RUNS=8
tables: setup
	$(BIN)/python -m tests.studies all $(if $(RUNS),--runs $(RUNS))

# Measured records with documented effects; they are not part of the repository: MEASURED_DATA=folder.
measured: setup
	$(BIN)/python -m tests.studies measured

# Effects of known size put into measured records.
plasmodes: setup
	$(BIN)/python -m tests.studies.plasmodes.windows
	$(BIN)/python -m tests.studies plasmodes --seed 10

bench: setup
	$(BIN)/python -m tests.benchmarks.bench_em

# Free runs found as a whole beside the loop over time.
bench-free-run: setup
	$(BIN)/python -m tests.benchmarks.bench_free_run

# Moment filters and free runs through tapes beside those by calls.
bench-tape: setup
	$(BIN)/python -m tests.benchmarks.bench_tape

# A model written in different ways, its functions on tape beside calls of them.
bench-written: setup
	$(BIN)/python -m tests.benchmarks.bench_written

# A diagnosis of differential equations beside that of an older commit: AGAINST=commit, MODEL=tanks or room.
bench-continuous: setup
	$(BIN)/python -m tests.benchmarks.bench_continuous --against $(AGAINST) $(if $(MODEL),--model $(MODEL))

# Small matrices in one thread of linear algebra and in all, beside idle and busy cores.
bench-busy-cores: setup
	$(BIN)/python -m tests.benchmarks.bench_busy_cores

warm: setup
	$(BIN)/python -m engine.compile_kernels

# The service under 200 jobs and 50 polling clients; under one large body; and killed, suspended and
# with its clock set at 50 random moments.
load: setup
	$(BIN)/python -m tests.benchmarks.load

large-bodies: setup
	$(BIN)/python -m tests.benchmarks.large_bodies

chaos: setup
	$(BIN)/python -m tests.benchmarks.chaos

# One study on a Dask scheduler with one worker and with two.
bench-dask: setup
	$(BIN)/python -m tests.benchmarks.bench_dask

# Each target sets up the environment first, once (docker/README.md).
.PHONY: help demo test test-slow test-mpi test-next docs lint format clean

RUN := docker/run
PYTHON_FILES := opticcup_fem tests $(wildcard demos benchmarks meshes)

help:
	@echo 'make demo       grow the chick optic cup (demos/chick.toml) into results/chick'
	@echo 'make test       the tests that take seconds'
	@echo 'make test-slow  the others: convergence, published curves, whole runs'
	@echo 'make test-mpi   the tests marked mpi, on 2 and on 3 processes'
	@echo 'make test-next  make test, on the dolfinx of Debian sid'
	@echo 'make docs       the documentation as a site in docs/_build (warnings are errors)'
	@echo 'make lint       ruff and mypy'
	@echo 'make format     ruff, writing'
	@echo 'make clean      remove what tests, docs and tools left here (results stay)'

demo:
	@$(RUN) opticcup run demos/chick.toml --out results/chick
	@echo 'The results are in $(CURDIR)/results/chick: look at summary.png first.'

test:
	@$(RUN) python3 -m pytest -m 'not slow'

test-slow:
	@$(RUN) python3 -m pytest -m slow

test-mpi:
	@$(RUN) mpirun -n 2 python3 -m pytest -m mpi -p no:cacheprovider --color=no -q
	@$(RUN) mpirun -n 3 python3 -m pytest -m mpi -p no:cacheprovider --color=no -q

test-next:
	@OPTICCUP_SUITE=sid $(RUN) python3 -m pytest -m 'not slow'

docs:
	@$(RUN) python3 -m sphinx --fail-on-warning --keep-going -q -d docs/_build/doctrees docs docs/_build/html
	@echo 'The site begins at $(CURDIR)/docs/_build/html/index.html.'

lint:
	@$(RUN) ruff check $(PYTHON_FILES)
	@$(RUN) ruff format --check $(PYTHON_FILES)
	@$(RUN) mypy

format:
	@$(RUN) ruff check --fix $(PYTHON_FILES)
	@$(RUN) ruff format $(PYTHON_FILES)

clean:
	rm -rf docs/_build docs/_generated .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage build *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

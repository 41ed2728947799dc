# Each target sets itself up in .venv; see scripts/ to do the same without make.
.PHONY: help setup demo test study long lint bench docs clean

help:
	@echo "make setup  install into .venv; then: source .venv/bin/activate"
	@echo "make demo   diagnose a log, extend the simulator, train in both, run on the unit; writes demo_out/index.html"
	@echo "make test   run the tests but the long ones"
	@echo "make study  run the long tests: whole diagnoses of hidden effects"
	@echo "make long   run the longest of these, and further cases"
	@echo "make lint   ruff and basedpyright"
	@echo "make bench  tests against stable-baselines3, and the benchmarks against the peers (about half an hour)"
	@echo "make docs   the documentation, into docs/_build/html"
	@echo "make clean  remove .venv and build output"

setup:
	@scripts/setup.sh dev

demo: setup
	@scripts/demo.sh

test: setup
	@scripts/test.sh

study: setup
	@scripts/study.sh

long: setup
	@scripts/long.sh

lint: setup
	@scripts/lint.sh

bench:
	@scripts/setup.sh dev bench
	@scripts/bench.sh

docs:
	@scripts/setup.sh dev docs
	@.venv/bin/sphinx-build -W --keep-going -b html docs docs/_build/html

clean:
	rm -rf .venv build docs/_build *.egg-info

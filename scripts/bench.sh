#!/usr/bin/env bash
# Benchmarks against named peers, and the tests that need them.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/environment.sh
.venv/bin/python -m pytest tests/bench "$@"
.venv/bin/python -m experiments.benchmarks.planner_benchmark
.venv/bin/python -m experiments.benchmarks.graph_benchmark

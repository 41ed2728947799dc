#!/usr/bin/env bash
# Runs the tests but the long diagnoses of scripts/study.sh and scripts/long.sh and the peers of scripts/bench.sh, two
# processes side by side; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/environment.sh
exec .venv/bin/python -m pytest -n "${TEST_PROCESSES:-2}" --dist worksteal -m "not study" --ignore=tests/bench "$@"

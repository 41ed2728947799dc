#!/usr/bin/env bash
# Runs the whole diagnoses that are too long for scripts/test.sh, but for those of scripts/long.sh, two processes side by
# side; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/environment.sh
# Only the files that have such tests: to collect all takes longer than some of them run.
mapfile -t files < <(grep -rlE --include='test_*.py' 'mark\.study|studied\(' tests | sort)
exec .venv/bin/python -m pytest -n "${TEST_PROCESSES:-2}" --dist worksteal -m "study and not long" "$@" "${files[@]}"

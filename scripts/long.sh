#!/usr/bin/env bash
# Runs the longest diagnoses and further cases of others, two processes side by side; arguments go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/environment.sh
exec .venv/bin/python -m pytest -n "${TEST_PROCESSES:-2}" --dist worksteal --timeout 1200 -m long "$@"

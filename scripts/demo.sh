#!/usr/bin/env bash
# The main job from end to end, at most 8 minutes on 2 cores; writes demo_out/index.html.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/environment.sh
exec .venv/bin/python -m experiments.demo "$@"

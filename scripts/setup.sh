#!/usr/bin/env bash
# Installs the package in editable form, with the extras given as arguments, into .venv; does nothing when that is done.
set -euo pipefail
cd "$(dirname "$0")/.."
extras=$(IFS=,; echo "${*:-dev}")
python=${PYTHON:-python3}
if [ ! -x .venv/bin/python ]; then
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
        echo "setup: $("$python" --version) is too old; set PYTHON to Python 3.11 or newer" >&2
        exit 2
    }
    "$python" -m venv .venv
fi
stamp=.venv/.installed-$extras
digest=$(cat pyproject.toml setup.py constraints.txt | sha256sum)
if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$digest" ]; then
    echo "setup: installing deepkoco[$extras] into .venv (a few minutes the first time)"
    # torch by its pinned version first: then no other requirement can pull a second, larger build.
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt torch
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[$extras]"
    echo "$digest" > "$stamp"
fi

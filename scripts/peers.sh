#!/usr/bin/env bash
# Makes .venv-peers and .venv-eagerx, environments of the packages that the benchmarks compare with; does nothing when
# that is done. EAGERx has its own because it wants an older networkx.
set -euo pipefail
cd "$(dirname "$0")/.."
packages=(
    "supergraph==0.0.8" "rex-lib==0.0.12" "jax==0.7.1" "jaxlib==0.7.1" "networkx==3.6.1" "numpy==1.26.4"
    "flax==0.12.0" "optax==0.2.8" "equinox==0.13.0" "distrax==0.1.9" "chex==0.1.92" "evosax==0.1.6"
)
python=${PYTHON:-python3}
if [ ! -x .venv-peers/bin/python ]; then
    "$python" -m venv .venv-peers
fi
stamp=.venv-peers/.installed
wanted=$(printf '%s\n' "${packages[@]}" | sha256sum)
if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$wanted" ]; then
    if .venv-peers/bin/python -m pip freeze --disable-pip-version-check |
        awk -v wanted="${packages[*]}" 'BEGIN { n = split(wanted, w, " ") } { have[$0] }
            END { for (i = 1; i <= n; i++) if (!(w[i] in have)) exit 1 }'; then
        :
    else
        echo "peers: installing ${packages[0]}, ${packages[1]} and what they need into .venv-peers (a few minutes)"
        .venv-peers/bin/python -m pip install --quiet --disable-pip-version-check "${packages[@]}"
    fi
    echo "$wanted" > "$stamp"
fi

eagerx=("eagerx==0.1.40" "eagerx-ode==0.1.26" "eagerx-tutorials==0.1.35" "numpy==1.26.4" "opencv-python==4.11.0.86")
stamp=.venv-eagerx/.installed
wanted=$(printf '%s\n' "${eagerx[@]}" | sha256sum)
if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$wanted" ]; then
    [ -x .venv-eagerx/bin/python ] || "$python" -m venv .venv-eagerx
    echo "peers: installing ${eagerx[0]} and what it needs into .venv-eagerx (a few minutes)"
    .venv-eagerx/bin/python -m pip install --quiet --disable-pip-version-check "${eagerx[@]}"
    echo "$wanted" > "$stamp"
fi

"""Training with and without delays, evaluated on a unit that has them (thesis Fig. 3.6).

    python -m experiments.studies.learning.delay_training --out results/graph/delay_training

The unit differs from the nominal rod pendulum only in its delays. One agent is trained in a simulator
without delays, one in a simulator that draws them from the unit's laws. Both see their last actions.
"""

from __future__ import annotations

import sys

from experiments.studies.learning.sac_on_unit import Bench, Study, main

ACTUATION = {"mean": 0.05, "sd": 0.01}  # [s]
SENSING = {"mean": 0.04, "sd": 0.01}  # [s]


def _law(effect: dict[str, float]) -> dict[str, object]:
    return {"law": "gaussian", "loc": effect["mean"], "scale": effect["sd"]}


STUDY = Study(
    name="delay_training",
    title="Trained with and without delays, run on a unit with delays",
    benches={
        "rod_pendulum": Bench(
            "deepkoco/RodPendulumDelay-v0",
            unit={"effects": {"actuation_delay": {"delay": ACTUATION}, "sensing_delay": {"delay": SENSING}}},
            steps=12_000,
        )
    },
    conditions={
        "without delays": {"rod_pendulum": {}},
        "with delays": {"rod_pendulum": {"actuation_delay": _law(ACTUATION), "sensing_delay": _law(SENSING)}},
    },
)

if __name__ == "__main__":
    sys.exit(main(STUDY, (__doc__ or "").splitlines()[0]))

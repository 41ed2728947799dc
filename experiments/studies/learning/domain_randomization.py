"""Training with and without domain randomization and delay simulation, evaluated on a unit (thesis Fig. 2.9).

    python -m experiments.studies.learning.domain_randomization --out results/graph/domain_randomization

The units of the rod and of the disk pendulum differ from their simulators in several parameters, and they
have delays. Agents are trained in the nominal simulator, with random parameters, with delays, and with both.
"""

from __future__ import annotations

import sys

from experiments.studies.learning.sac_on_unit import Bench, Study, main

PARAMETERS = {
    "rod_pendulum": {"mass": (0.75, 1.25), "length": (0.9, 1.1), "viscous": (0.0, 0.15)},
    "pendulum": {
        "inertia": (1.3e-4, 1.9e-4),
        "mass": (0.042, 0.06),
        "motor_constant": (0.027, 0.04),
        "viscous": (0.7e-5, 3e-5),
        "coulomb": (5e-4, 2e-3),
    },
}
# Delays are drawn from a range, not known: one of each per episode [s].
DELAYS = {
    "rod_pendulum": {"actuation_delay": (0.02, 0.08), "sensing_delay": (0.01, 0.06)},
    "pendulum": {"actuation_delay": (0.005, 0.03), "sensing_delay": (0.005, 0.025)},
}

STUDY = Study(
    name="domain_randomization",
    title="Trained with and without random parameters and delays, run on a unit",
    benches={
        "rod_pendulum": Bench(
            "deepkoco/RodPendulumDelay-v0",
            unit={
                "parameters": {"mass": 1.15, "length": 1.05, "viscous": 0.05},
                "effects": {
                    "actuation_delay": {"delay": {"mean": 0.05, "sd": 0.005}},
                    "sensing_delay": {"delay": {"mean": 0.03, "sd": 0.005}},
                },
            },
            steps=48_000,
            updates_every=2,
        ),
        "pendulum": Bench(
            "deepkoco/Pendulum-v0",
            unit={
                "parameters": {
                    "inertia": 1.75e-4,
                    "mass": 0.057,
                    "motor_constant": 0.0305,
                    "coulomb": 1.4e-3,
                },
                "effects": {
                    "actuation_delay": {"delay": {"mean": 0.018, "sd": 0.003}},
                    "sensing_delay": {"delay": {"mean": 0.014, "sd": 0.003}},
                },
            },
            steps=60_000,
            updates_every=2,
            gamma=0.99,
        ),
    },
    conditions={
        "nominal": {system: {} for system in PARAMETERS},
        "random parameters": {system: {"randomize": span} for system, span in PARAMETERS.items()},
        "delays": {system: {"randomize": span} for system, span in DELAYS.items()},
        "random parameters and delays": {
            system: {"randomize": {**PARAMETERS[system], **DELAYS[system]}} for system in PARAMETERS
        },
    },
)

if __name__ == "__main__":
    sys.exit(main(STUDY, (__doc__ or "").splitlines()[0]))

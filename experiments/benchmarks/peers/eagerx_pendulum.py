"""EAGERx's pendulum in one process, run by the interpreter that EAGERx is installed for.

`python experiments/benchmarks/peers/eagerx_pendulum.py STEPS` takes steps when a line comes in on its standard
input and answers each with one line of JSON: CPU and wall seconds of STEPS steps.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import eagerx  # pyright: ignore[reportMissingImports]
from eagerx.backends.single_process import SingleProcess  # pyright: ignore[reportMissingImports]
from eagerx_ode.engine import OdeEngine  # pyright: ignore[reportMissingImports]
from eagerx_tutorials.pendulum.objects import Pendulum  # pyright: ignore[reportMissingImports]

RATE = 20.0  # [Hz]
SENSING_DELAY = 0.02  # [s]
EPISODE = 200


class Environment(eagerx.BaseEnv):
    """Swing-up on two sensors with a delay, as EAGERx's users write it."""

    def __init__(self, name: str, rate: float, graph: Any, engine: Any, backend: Any) -> None:
        super().__init__(name, rate, graph, engine, backend=backend, force_start=True)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation = self._step(action)
        cost = float(observation["theta"][0]) ** 2 + 0.1 * float(observation["theta_dot"][0]) ** 2
        return observation, -cost, False, False, {}

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        return self._reset(self.state_space.sample()), {}


def make_environment() -> Environment:
    """The environment, synchronised, as fast as it goes."""
    pendulum = Pendulum.make(
        "pendulum", actuators=["u"], sensors=["theta", "theta_dot"], states=["model_state"], rate=RATE
    )
    graph = eagerx.Graph.create()
    graph.add(pendulum)
    graph.connect(action="voltage", target=pendulum.actuators.u)
    for sensor in ("theta", "theta_dot"):
        graph.connect(source=getattr(pendulum.sensors, sensor), observation=sensor, delay=SENSING_DELAY)
    engine = OdeEngine.make(rate=RATE, sync=True, real_time_factor=0)
    return Environment("pendulum", RATE, graph, engine, SingleProcess.make())


def main() -> None:
    steps = int(sys.argv[1])
    environment = make_environment()
    environment.reset()
    action = environment.action_space.sample()
    for _ in range(50):
        environment.step(action)
    for _ in sys.stdin:
        environment.reset()
        cpu, wall = time.process_time(), time.perf_counter()
        for step in range(1, steps + 1):
            environment.step(action)
            if step % EPISODE == 0 and step < steps:
                environment.reset()
        seconds = {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall}
        print("RESULT " + json.dumps(seconds), flush=True)
    environment.shutdown()


if __name__ == "__main__":
    main()

"""The fit of `identify_peer.py` for the peer REX; started by its own Python, told what to do line by line.

Reads one JSON object a line: {"do": "costs", "generations": [[point, ...], ...]}, {"do": "fit", "seed": s} or
{"do": "quit"}. Answers each with the seconds of the clock and of the processor. The loss is summed in the state of the
supervisor, as REX's own examples do, and the search is REX's `evo` with CMA-ES of evosax, one compiled function.
"""

import argparse
import json
import sys
import time

BEGIN = time.perf_counter()

import jax  # noqa: E402  # pyright: ignore[reportMissingImports]
import jax.numpy as jnp  # noqa: E402  # pyright: ignore[reportMissingImports]
import numpy as np  # noqa: E402
from flax import struct  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex import base, evo  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex.graph import Graph  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex.node import BaseNode  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex_rollout import Relay, Vector, World  # noqa: E402  # pyright: ignore[reportMissingImports]


@struct.dataclass
class Loss(base.Base):
    """What the replay has missed so far."""

    value: jax.Array


@struct.dataclass
class Data(base.Base):
    """Commands (steps, 1), and readings (steps, 2) over their noise with weight 0 where there is none."""

    command: jax.Array
    reading: jax.Array
    weight: jax.Array


class FixedWorld(World):
    """The pendulum from a known state."""

    def __init__(self, *args, initial, **kwargs):
        super().__init__(*args, **kwargs)
        self.initial = initial

    def init_state(self, rng=None, graph_state=None):
        return Vector(jnp.array(self.initial, jnp.float32))


class Judge(BaseNode):
    """Plays the commands and sums the squared errors of what it sees."""

    def __init__(self, *args, recorded, **kwargs):
        super().__init__(*args, **kwargs)
        self.recorded = recorded

    def init_params(self, rng=None, graph_state=None):
        return self.recorded

    def init_state(self, rng=None, graph_state=None):
        return Loss(jnp.float32(0.0))

    def init_output(self, rng=None, graph_state=None):
        return Vector(jnp.zeros(1, jnp.float32))

    def step(self, step_state):
        data, k = step_state.params, step_state.seq
        seen = step_state.inputs["sensor"].data.value[-1]
        miss = (seen - data.reading[k]) * data.weight[k]
        state = Loss(step_state.state.value + (miss**2).sum())
        return step_state.replace(state=state), Vector(data.command[k])


def make_graph(work: dict) -> Graph:
    """World, sensor, actuator and the judge, over the steps and messages of the recorded episode."""
    recorded = Data(*(jnp.array(work[name], jnp.float32) for name in ("command", "reading", "weight")))
    world = FixedWorld(
        name="world", rate=work["world_rate"], values=work["parameters"], initial=work["initial"]
    )
    sensor = Relay(name="sensor", rate=work["agent_rate"], size=2)
    actuator = Relay(name="actuator", rate=work["agent_rate"], size=1)
    judge = Judge(name="agent", rate=work["agent_rate"], recorded=recorded)
    sensor.connect(world)
    judge.connect(sensor)
    actuator.connect(judge)
    world.connect(actuator, skip=True)
    nodes = {node.name: node for node in (world, sensor, actuator, judge)}
    vertices = {
        name: base.Vertex(np.arange(len(start))[None], np.array([start]), np.array([end]))
        for name, (start, end) in work["vertices"].items()
    }
    edges = {
        (sender, receiver): base.Edge(np.arange(len(taken))[None], np.array([taken]), np.array([arrived]))
        for sender, receiver, taken, arrived in work["edges"]
    }
    return Graph(nodes, judge, base.Graph(vertices, edges), progress_bar=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", help="JSON file that says what the work is")
    with open(parser.parse_args().work) as file:
        work = json.load(file)
    answers, sys.stdout = sys.stdout, sys.stderr  # REX itself prints
    graph = make_graph(work)
    names, size = work["sought"], len(work["sought"])
    low, high = (jnp.array(work[side], jnp.float32) for side in ("low", "high"))
    nominal = graph.nodes["world"].init_params()
    order = ("world", "agent", "sensor", "actuator")

    def loss(x, transform, rng):
        del transform  # the search runs between -1 and 1
        values = low + 0.5 * (x["x"] + 1.0) * (high - low)
        physics = nominal.replace(**dict(zip(names, values, strict=True)))
        state = graph.init(rng, params={"world": physics}, order=order)
        return graph.rollout(state, max_steps=work["steps"] + 1, carry_only=True).state["agent"].value

    one = {"x": jnp.ones(size, jnp.float32)}
    solver = evo.EvoSolver.init(
        {"x": -one["x"]}, one, "CMA_ES", {"popsize": work["population"], "sigma_init": 0.5}
    )

    def search(rng):
        state = solver.init_state({"x": jnp.array(work["start"], jnp.float32)}, rng)
        return evo.evo(loss, solver, state, None, work["generations"], rng, verbose=False)

    keys = jax.random.split(jax.random.PRNGKey(0), work["population"])
    costs = jax.jit(lambda x: jax.vmap(loss, in_axes=({"x": 0}, None, 0))({"x": x}, None, keys))
    fit = jax.jit(search)
    compiled = {}

    def answer(asked: dict) -> dict:
        if asked["do"] == "costs":
            scaled = (
                2.0 * (np.array(asked["generations"]) - work["low"]) / (np.array(work["high"]) - work["low"])
                - 1.0
            )
            return {"costs": [np.asarray(costs(jnp.array(x, jnp.float32))).tolist() for x in scaled]}
        state, _, losses = jax.block_until_ready(fit(jax.random.PRNGKey(asked["seed"])))
        best = np.asarray(low + 0.5 * (state.best_member + 1.0) * (high - low))
        return {
            "best": best.tolist(),
            "cost": float(state.best_fitness),
            "lowest": np.nanmin(np.asarray(losses), 1).tolist(),
        }

    print(json.dumps({"import_seconds": time.perf_counter() - BEGIN}), file=answers, flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        if asked["do"] == "quit":
            break
        first = None
        if asked["do"] not in compiled:
            begin = time.perf_counter()
            answer(asked)
            first = compiled[asked["do"]] = time.perf_counter() - begin
        begin, cpu = time.perf_counter(), time.process_time()
        result = answer(asked)
        seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
        print(
            json.dumps({**result, "seconds": seconds, "cpu": cpu, "first": first}), file=answers, flush=True
        )


if __name__ == "__main__":
    main()

"""The work of `rollout_work.py` for the peer REX; started by its own Python, told what to do line by line.

Reads one JSON object a line: {"do": "rollout", "batch": B, "times": n}, {"do": "population", ...} or
{"do": "quit"}. Answers each with the seconds of the clock and of the processor that n runs took, and after
the first of a kind how long it took to come to it and the bytes of an environment.
"""

import argparse
import json
import sys
import time

BEGIN = time.perf_counter()

import distrax  # noqa: E402  # pyright: ignore[reportMissingImports]
import jax  # noqa: E402  # pyright: ignore[reportMissingImports]
import jax.numpy as jnp  # noqa: E402  # pyright: ignore[reportMissingImports]
import numpy as np  # noqa: E402
from flax import struct  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex import base  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex.artificial import generate_graphs  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex.graph import Graph  # noqa: E402  # pyright: ignore[reportMissingImports]
from rex.node import BaseNode  # noqa: E402  # pyright: ignore[reportMissingImports]

GRAVITY, SMOOTHING, SPEED_LIMIT = 9.81, 0.1, 40.0


@struct.dataclass
class Vector(base.Base):
    """A message of numbers."""

    value: jax.Array


@struct.dataclass
class Physics(base.Base):
    """Parameters of the pendulum."""

    inertia: jax.Array
    mass: jax.Array
    length: jax.Array
    viscous: jax.Array
    motor_constant: jax.Array
    resistance: jax.Array
    coulomb: jax.Array


@struct.dataclass
class Weights(base.Base):
    """Layers of the policy; `given` holds actions (steps, 1) to take instead."""

    layers: tuple
    given: jax.Array


class World(BaseNode):
    """Integrates the pendulum by one Runge-Kutta step a tick."""

    def __init__(self, *args, values, **kwargs):
        super().__init__(*args, **kwargs)
        self.values = values

    def init_params(self, rng=None, graph_state=None):
        return Physics(**{name: jnp.float32(value) for name, value in self.values.items()})

    def init_state(self, rng=None, graph_state=None):
        angle = jax.random.uniform(rng, (), minval=-jnp.pi, maxval=jnp.pi)
        return Vector(jnp.stack([angle, jnp.float32(0.0)]))

    def init_output(self, rng=None, graph_state=None):
        return Vector(graph_state.state[self.name].value)  # pyright: ignore[reportOptionalMemberAccess]

    def step(self, step_state):
        p, x, dt = step_state.params, step_state.state.value, 1 / self.rate
        effort = step_state.inputs["actuator"].data.value[-1][0]

        def slope(x):
            angle, speed = x[0], x[1]
            motor = (effort - speed * p.motor_constant) * p.motor_constant / p.resistance
            gravity = p.mass * GRAVITY * p.length * jnp.sin(angle)
            friction = p.viscous * speed + p.coulomb * jnp.tanh(speed / SMOOTHING)
            return jnp.stack([speed, (motor + gravity - friction) / p.inertia])

        k1 = slope(x)
        k2 = slope(x + 0.5 * dt * k1)
        k3 = slope(x + 0.5 * dt * k2)
        k4 = slope(x + dt * k3)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x = jnp.stack([x[0], jnp.clip(x[1], -SPEED_LIMIT, SPEED_LIMIT)])
        return step_state.replace(state=Vector(x)), Vector(x)


class Relay(BaseNode):
    """Passes the last message on."""

    def __init__(self, *args, size, **kwargs):
        super().__init__(*args, **kwargs)
        self.size = size

    def init_output(self, rng=None, graph_state=None):
        return Vector(jnp.zeros(self.size, jnp.float32))

    def step(self, step_state):
        (seen,) = step_state.inputs.values()
        return step_state, Vector(seen.data.value[-1])


class Agent(BaseNode):
    """The policy: two layers of tanh units on cosine, sine and speed of the last measurements."""

    def __init__(self, *args, weights, **kwargs):
        super().__init__(*args, **kwargs)
        self.weights = weights

    def init_params(self, rng=None, graph_state=None):
        return self.weights

    def init_output(self, rng=None, graph_state=None):
        return Vector(jnp.zeros(1, jnp.float32))

    def step(self, step_state):
        weights = step_state.params
        if weights.given.size:
            return step_state, Vector(weights.given[step_state.seq])
        angle, speed = jnp.moveaxis(step_state.inputs["sensor"].data.value, -1, 0)
        x = jnp.stack([jnp.cos(angle), jnp.sin(angle), speed], -1).flatten()
        for k, (matrix, bias) in enumerate(weights.layers):
            x = matrix @ x + bias
            x = jnp.tanh(x) if k < len(weights.layers) - 1 else x
        return step_state, Vector(x)


def make_graph(work: dict, steps: int, episodes: int, given: np.ndarray) -> Graph:
    """World, sensor, actuator and agent with random delays."""
    layers = tuple((jnp.array(w, jnp.float32), jnp.array(b, jnp.float32)) for w, b in work["layers"])
    world = World(name="world", rate=work["world_rate"], values=work["parameters"])
    sensor = Relay(name="sensor", rate=work["agent_rate"], size=2)
    actuator = Relay(name="actuator", rate=work["agent_rate"], size=1)
    weights = Weights(layers, jnp.array(given, jnp.float32))
    agent = Agent(name="agent", rate=work["agent_rate"], weights=weights)
    sensing, actuation = (distrax.Normal(*work[name]) for name in ("sensing", "actuation"))
    sensor.connect(world)
    agent.connect(sensor, delay_dist=sensing, delay=work["sensing"][0], window=work["window"])
    actuator.connect(agent, delay_dist=actuation, delay=work["actuation"][0])
    world.connect(actuator, skip=True)
    nodes = {node.name: node for node in (world, sensor, actuator, agent)}
    seconds = (steps + 4) / work["agent_rate"]
    graphs = generate_graphs(nodes, seconds, rng=jax.random.PRNGKey(0), num_episodes=episodes)
    return Graph(nodes, agent, graphs, progress_bar=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", help="JSON file that says what the work is")
    with open(parser.parse_args().work) as file:
        work = json.load(file)
    graphs, runs = {}, {}
    print(json.dumps({"import_seconds": time.perf_counter() - BEGIN}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        if asked["do"] == "quit":
            break
        kind, batch = asked["do"], asked["batch"]
        first, memory = None, None
        if (kind, batch) not in runs:
            begin = time.perf_counter()
            steps = work["steps"] if kind == "rollout" else work["population_steps"]
            if kind not in graphs:
                episodes = work["schedules"] if kind == "rollout" else 1
                given = np.zeros((0, 1)) if kind == "rollout" else np.array(work["actions"])
                graphs[kind] = make_graph(work, steps, episodes, given)
            graph = graphs[kind]
            built = time.perf_counter() - begin
            order = ("world", "agent", "sensor", "actuator")
            params = graph.nodes["world"].init_params()
            spread = np.linspace(0.8, 1.2, batch).astype(np.float32)

            def start(key, scale, graph=graph, kind=kind, params=params, order=order):
                own = {"world": params.replace(mass=params.mass * scale)} if kind == "population" else None
                return graph.init(key, params=own, randomize_eps=kind == "rollout", order=order)

            def go(state, graph=graph, steps=steps):
                return graph.rollout(state, max_steps=steps, carry_only=True).state["world"].value

            keys = jax.random.split(jax.random.PRNGKey(1), batch)
            state = jax.block_until_ready(jax.jit(jax.vmap(start))(keys, jnp.array(spread)))
            memory = sum(leaf.nbytes for leaf in jax.tree_util.tree_leaves(state)) / batch
            runs[kind, batch] = jax.jit(jax.vmap(go)), state
            jax.block_until_ready(runs[kind, batch][0](state))
            first = {"build": built, "total": time.perf_counter() - begin, "slots": len(graph.S)}
        function, state = runs[kind, batch]
        begin, cpu = time.perf_counter(), time.process_time()
        for _ in range(asked["times"]):
            jax.block_until_ready(function(state))
        seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
        print(json.dumps({"seconds": seconds, "cpu": cpu, "first": first, "memory": memory}), flush=True)


if __name__ == "__main__":
    main()

"""The pendulum of `gradient_work.py` for JAX; started by its own Python, told what to do line by line.

Reads one JSON object a line: {"do": "rex" or "scan", "what": "forward" or "gradient", "batch": B, "times": n} or
{"do": "quit"}; answers with the seconds of the clock and of the processor that n runs took. "rex" runs the graph with
its random delays in the peer REX; "scan" a loop written by hand, without delays and without a graph.
"""

import argparse
import json
import sys
import time

import jax  # pyright: ignore[reportMissingImports]
import jax.numpy as jnp  # pyright: ignore[reportMissingImports]
import numpy as np
from rex_rollout import SPEED_LIMIT, World, make_graph  # pyright: ignore[reportMissingImports]


def squares(final):
    return (final**2).sum()


def rex_loss(work, batch):
    """Loss as a function of parameters, starts and actions, and these."""
    steps = work["steps"]
    graph = make_graph(work, steps, work["schedules"], np.zeros((steps, 1)))
    order = ("world", "agent", "sensor", "actuator")
    keys = jax.random.split(jax.random.PRNGKey(1), batch)
    states = jax.jit(jax.vmap(lambda key: graph.init(key, randomize_eps=True, order=order)))(keys)

    def loss(physics, start, actions, states):
        def one(start, actions, state):
            agent = state.params["agent"].replace(given=actions)
            world = state.state["world"].replace(value=start)
            state = state.replace(
                params=state.params.copy({"world": physics, "agent": agent}),
                state=state.state.copy({"world": world}),
            )
            return graph.rollout(state, max_steps=steps, carry_only=True).state["world"].value

        return squares(jax.vmap(one)(start, actions, states))

    return loss, (graph.nodes["world"].init_params(), states.state["world"].value), (states,)


def scan_loss(work, batch):
    """The same without delays and graph: two ticks of the world per action, in one scan."""
    world = World(name="world", rate=work["world_rate"], values=work["parameters"])

    class Seen:
        def __init__(self, params, x, u):
            value = type("V", (), {"value": u[None]})
            self.params, self.state = params, type("V", (), {"value": x})
            self.inputs = {"actuator": type("I", (), {"data": value})}

        def replace(self, state):
            return state.value

    def loss(physics, start, actions):
        def one(x, actions):
            def tick(x, u):
                for _ in range(2):
                    x = world.step(Seen(physics, x, u))[0]
                return x, None

            return jax.lax.scan(tick, x, actions)[0]

        return squares(jax.vmap(one)(start, actions))

    angle = jax.random.uniform(jax.random.PRNGKey(0), (batch,), minval=-jnp.pi, maxval=jnp.pi)
    return loss, (world.init_params(), jnp.stack([angle, jnp.zeros(batch)], 1)), ()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", help="JSON file that says what the work is")
    with open(parser.parse_args().work) as file:
        work = json.load(file)
    runs = {}
    print(json.dumps({"limit": SPEED_LIMIT}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        if asked["do"] == "quit":
            break
        key = asked["do"], asked["what"], asked["batch"]
        first = None
        if key not in runs:
            begin = time.perf_counter()
            loss, given, rest = (rex_loss if key[0] == "rex" else scan_loss)(work, key[2])
            actions = jnp.array(work["actions"], jnp.float32)[None].repeat(key[2], 0)
            function = loss if key[1] == "forward" else jax.value_and_grad(loss, argnums=(0, 1, 2))
            runs[key] = jax.jit(function), (*given, actions, *rest)
            jax.block_until_ready(runs[key][0](*runs[key][1]))
            first = time.perf_counter() - begin
        function, arguments = runs[key]
        begin, cpu = time.perf_counter(), time.process_time()
        for _ in range(asked["times"]):
            jax.block_until_ready(function(*arguments))
        seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
        print(json.dumps({"seconds": seconds, "cpu": cpu, "first": first, "memory": None}), flush=True)


if __name__ == "__main__":
    main()

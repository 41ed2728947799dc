"""Nodes with several outputs, in a module of their own so that they travel to processes."""

import torch

from deepkoco.graph import Connection, Gaussian, Graph, Node, Supervisor


class Arm(Node):
    """Two joints that integrate the command; puts out their angles, and a wrench of another shape and type."""

    inputs = ("agent",)
    outputs = {  # noqa: RUF012
        "angles": ((2,), torch.float64),
        "wrench": ((2, 3), torch.float32),
        "contact": ((), torch.bool),
        "ticks": ((), torch.int32),
    }

    def init(self, parameters, generator, batch):
        return {
            "x": torch.rand(batch, 2, generator=generator, dtype=torch.float64),
            "ticks": torch.zeros(batch, dtype=torch.int32),
        }

    def initial_output(self, parameters, state, batch):
        return self.seen(state)

    def step(self, parameters, state, inputs, *, dt, noise):
        x = state["x"] + dt * inputs["agent"].data[:, -1] + 0.01 * noise.normal(2)
        state = {"x": x, "ticks": state["ticks"] + 1}
        return state, self.seen(state)

    def seen(self, state):
        angles = state["x"]
        wrench = torch.stack([angles, 2 * angles, angles**2], -1).to(torch.float32)
        contact = angles[:, 0] > angles[:, 1]
        # Not in the order of the declaration: names count.
        return {"wrench": wrench, "angles": angles, "ticks": state["ticks"], "contact": contact}


class Camera(Node):
    """A picture of the arm and when it was taken."""

    inputs = ("arm",)
    outputs = {"picture": ((4, 3), torch.float32), "stamp": ((), torch.float64)}  # noqa: RUF012

    def initial_output(self, parameters, state, batch):
        stamp = torch.full((batch,), -1.0, dtype=torch.float64)
        return {"picture": torch.zeros(batch, 4, 3), "stamp": stamp}

    def step(self, parameters, state, inputs):
        seen = inputs["arm"]
        newest, before = seen.data["wrench"][:, -1], seen.data["wrench"][:, 0]
        picture = (
            torch.cat([newest, before], 1) * torch.where(seen.data["contact"][:, -1], 1.0, 0.5)[:, None, None]
        )
        return state, {"picture": picture, "stamp": seen.t_start}


class Operator(Supervisor):
    """Reads parts of both."""

    inputs = ("arm", "camera")

    def observe(self, parameters, state, inputs, action):
        arm, camera = inputs["arm"].data, inputs["camera"].data
        age = inputs["camera"].t_start - camera["stamp"][:, -1]
        readings = {"observation": arm["angles"][:, -1], "age": age, "ticks": arm["ticks"][:, -1]}
        return state, readings | {"light": camera["picture"].sum((1, 2, 3))}


def dict_graph() -> Graph:
    agent = Operator("agent", 20, initial_action=torch.zeros(2, dtype=torch.float64))
    return Graph(
        [Arm("arm", 50), Camera("camera", 30), agent],
        [
            Connection("arm", "camera", window=3),
            Connection("arm", "agent", Gaussian(0.02, 0.01)),
            Connection("camera", "agent", Gaussian(0.02, 0.01), window=2),
            Connection("agent", "arm", Gaussian(0.02, 0.01), skip=True),
        ],
    )


def act(inputs) -> torch.Tensor:
    return -0.5 * inputs["arm"].data["angles"][:, -1]

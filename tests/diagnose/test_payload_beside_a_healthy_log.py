"""A hook carries more than in its healthy log, where each log alone tells ratios of load and motor only."""

import mujoco
import numpy as np
import pytest

import deepkoco
from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording, Series

HOIST = """<mujoco model="hoist"><option integrator="implicitfast" timestep="0.001"/><worldbody>
<body name="load"><joint name="hook" type="slide" axis="0 0 1" damping="{damping}" armature="5.5"/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="0.1 0.1 0.1"/></body></worldbody>
<actuator><motor name="winch" joint="hook" gear="80"/></actuator></mujoco>"""
RATE, SECONDS, NOISE = 100, 12.0, 2e-5


def moved(mass, seed, names):
    """Log of a unit that holds this mass, under a controller that knows nothing of it."""
    model = mujoco.MjModel.from_xml_string(HOIST.format(mass=mass, damping=14.4))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    tones, phases = rng.uniform(0.2, 1.6, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    goal = 0.12 * np.sin(2.0 * np.pi * tones * t[:, None] + phases).sum(1)
    shown, sent = np.empty((2, len(t)))
    for k, wanted in enumerate(goal):
        shown[k] = data.qpos[0] + NOISE * rng.normal()
        sent[k] = round((8.0 * 9.81 + 900.0 * (wanted - data.qpos[0]) - 130.0 * data.qvel[0]) / 80.0, 3)
        data.ctrl[0] = sent[k]
        mujoco.mj_step(model, data, round(1000 / RATE))
    position, command = names
    return Recording(
        {
            position: Series(t, shown, "m", "measurement"),
            command: Series(t, sent, "1", "command"),
        }
    )


@pytest.mark.study
@pytest.mark.timeout(300)
@pytest.mark.parametrize(("more", "named"), [(1.4, ("payload",)), (0.0, ())])
def test_more_load_than_in_one_healthy_log_is_named_although_each_tells_ratios_only(tmp_path, more, named):
    (tmp_path / "hoist.xml").write_text(HOIST.format(mass=8.0, damping=14.0))
    robot = deepkoco.load_system(tmp_path / "hoist.xml")
    channels = ("q_hook", "winch")
    healthy, log = moved(8.1, 1, channels), moved(8.1 + more, 2, channels)
    found = diagnose([log], robot, healthy=[healthy], only=["payload", "viscous", "coulomb", "gain"])
    assert found.names == named
    if named:
        size = found.causes[0].parameters["payload.mass"]
        assert size.low < more < size.high

"""Which combinations of inertial parameters a motion can show, against closed forms and MuJoCo."""

import numpy as np
import pytest
import torch

from deepkoco.systems.motion import Motion
from deepkoco.systems.trees.base_parameters import base_parameters
from tests.systems.trees.random_trees import columns, random_motions, random_tree
from tests.systems.trees.test_tree_reading import mjcf, read

PENDULUM = mjcf(
    '<body name="arm"><joint name="hinge" axis="0 1 0"/>'
    '<inertial pos="0.02 0 -0.2" mass="1" diaginertia="0.01 0.01 0.002"/></body>',
    '<actuator><motor name="m" joint="hinge"/></actuator>',
)


def swing(seconds, amplitude):
    t = np.arange(0.0, seconds, 0.01)
    return t, amplitude * np.sin(2.0 * np.pi * 0.7 * t)[:, None]


def test_a_swinging_pendulum_shows_three_numbers(tmp_path):
    # I + m c^2 about the axis, and the two first moments m c_x and m c_z by their weights.
    system = read(tmp_path, PENDULUM)
    t, angles = swing(20.0, 1.5)
    found = base_parameters(system, t, angles, np.zeros((len(t), 1)), load_noise=1e-5)
    inertial = [n for n in found.base if not n.startswith("gain")]
    assert len(inertial) == 3
    assert "3 combinations" in str(found).splitlines()[0]


def test_a_pendulum_at_rest_shows_its_first_moment_across_only(tmp_path):
    system = read(tmp_path, PENDULUM)
    t = np.arange(0.0, 5.0, 0.01)
    found = base_parameters(system, t, np.zeros((len(t), 1)), np.zeros((len(t), 1)), load_noise=1e-3)
    # At angle 0 only m c_x has a weight about the axis; the mass looks like com_x by c_x / m = 0.02 m/kg.
    assert found.base == ("com_x(arm)",)
    assert found.combinations["com_x(arm)"]["mass(arm)"] == pytest.approx(0.02, rel=1e-3)
    assert "inertia_y(arm)" in found.unseen


@pytest.mark.parametrize("seed", [2, 7])
def test_needed_loads_bring_about_the_accelerations(seed):
    model, system = random_tree(seed)
    parameters = system.default_parameters()
    angles, speeds, controls, wanted = (
        columns(x) for x in random_motions(np.random.default_rng(seed), model, 4)
    )
    motion = Motion(angles, speeds, controls)
    loads = system.needed_loads(parameters)(motion, wanted)
    found = system.accelerations(parameters)(motion._replace(loads=loads))
    torch.testing.assert_close(torch.stack(found), torch.stack(wanted), rtol=1e-7, atol=1e-7)

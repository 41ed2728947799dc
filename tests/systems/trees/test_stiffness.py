"""What simulations follow of a stiff servo's motion, and what logs of some rate show of it."""

import math

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")

from deepkoco.fit.data.windows import cut_windows
from deepkoco.fit.simulate.simulator import predict
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, any_system
from deepkoco.systems.trees.stiffness import pace_of

# Swings of about 470 and 510 rad/s. Dry friction takes 11 and 15 mrad from them in each half turn, of which there are
# 13 from one sample of a slow log to the next.
STIFF_ARM = """
<mujoco model="stiff arm">
  <worldbody>
    <body name="upper">
      <inertial pos="0.1 0 0" mass="0.4" diaginertia="2e-4 1e-3 1e-3"/>
      <joint name="shoulder" axis="0 1 0" damping="1" frictionloss="5"/>
      <body name="lower" pos="0.2 0 0">
        <inertial pos="0.06 0 0" mass="0.15" diaginertia="1e-4 4e-4 4e-4"/>
        <joint name="elbow" axis="0 1 0" damping="0.2" frictionloss="1.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="900" ctrlrange="-2 2"/>
    <position name="elbow" joint="elbow" kp="200" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("stiff") / "arm.xml"
    path.write_text(STIFF_ARM)
    return any_system(str(path))


def log_every(interval, system, seconds=6.0):
    """Goals that swing slowly, held from sample to sample, as measured positions too."""
    t = np.arange(round(seconds / interval)) * interval
    goals = [0.5 * np.sin(2.0 * t + k) for k in range(2)]
    channels = {c.name: Series(t, g, c.unit, "command") for c, g in zip(system.commands, goals, strict=True)}
    shown = zip(system.measurements, goals, strict=False)
    return Recording(channels | {c.name: Series(t, g, c.unit, "measurement") for c, g in shown})


def simulated(system, log, state, factors=None):
    windows = cut_windows([log], system, 1.0)
    states = state.expand(1, len(windows), -1).clone()
    states[0, :, :2] += windows.state[:, :2]
    values = system.default_parameters()
    values |= {n: factor * values[n] for n, factor in (factors or {}).items()}
    return windows, predict(system, windows, values, states)[0, :, :2]


def test_a_slow_log_has_twelve_steps_a_sample():
    # 2 pi / 0.06 = 105 rad/s; a twelfth of 60 ms is 5 ms, in which 1.9 / 5 ms = 380 1/s is stable and 2.2 / 5 ms fades.
    pace, step = pace_of(0.06)
    assert step == pytest.approx(5e-3)
    assert pace == pytest.approx((380.0, 440.0, 2.0 * math.pi / 0.06))


def test_the_step_of_a_fit_bounds_that_of_a_slow_log():
    pace, step = pace_of(1.0)
    assert step == 0.01
    assert (pace.decay, pace.swing) == pytest.approx((190.0, 220.0))


def test_a_slow_log_does_not_ask_for_the_steps_of_a_stiff_servo(arm):
    assert arm.longest_step < 1.5e-3
    assert arm.sampled_every(0.09).longest_step > 6e-3


def test_a_fast_log_keeps_the_steps_of_a_stiff_servo(arm):
    assert arm.sampled_every(0.002) is arm


def test_a_robot_that_needs_no_shorter_steps_stays_as_it_is(tmp_path):
    path = tmp_path / "soft.xml"
    path.write_text(STIFF_ARM.replace('kp="900"', 'kp="5"').replace('kp="200"', 'kp="1"'))
    soft = any_system(str(path))
    assert soft.sampled_every(0.02) is soft


@pytest.mark.parametrize(
    ("friction", "damping", "interval", "slower"),
    [
        ((5.0, 1.5), (1.0, 0.2), 0.09, True),  # 110 and 280 mrad are taken from a swing within a sample
        ((1.0, 0.3), (1.0, 0.2), 0.09, False),  # 22 and 57 mrad
        ((0.0, 0.0), (1.0, 0.2), 0.09, False),  # a tenth is left of a swing
        ((0.0, 0.0), (4.0, 0.8), 0.09, True),  # damping ends it
        ((5.0, 1.5), (1.0, 0.2), 0.02, False),  # 3 half turns
    ],
    ids=["friction", "little friction", "little damping", "damping", "usual samples"],
)
def test_only_swings_that_are_over_by_the_next_sample_are_not_followed(
    tmp_path, friction, damping, interval, slower
):
    path = tmp_path / "arm.xml"
    text = STIFF_ARM
    for (old, own), new in zip(
        (('damping="1"', "5"), ('damping="0.2"', "1.5")), zip(damping, friction, strict=True), strict=True
    ):
        text = text.replace(f'{old} frictionloss="{own}"', f'damping="{new[0]}" frictionloss="{new[1]}"')
    path.write_text(text)
    arm = any_system(str(path))
    assert (arm.sampled_every(interval, {"shoulder": 0.05}).longest_step > arm.longest_step) == slower


def test_a_swing_after_a_large_jump_of_a_goal_is_followed(arm):
    # Within a sample 110 mrad are taken from a swing of the shoulder.
    assert arm.sampled_every(0.09, {"shoulder": 0.05, "elbow": 0.05}).longest_step > arm.longest_step
    assert arm.sampled_every(0.09, {"shoulder": 0.2}) is arm


def test_rates_that_were_asked_for_before_do_not_matter(arm):
    slow = arm.sampled_every(0.09)
    assert slow.sampled_every(0.0) is arm
    assert slow.sampled_every(0.002) is arm
    assert slow.sampled_every(0.06).longest_step == arm.sampled_every(0.06).longest_step < slow.longest_step


def test_what_samples_show_is_that_of_fine_steps(arm):
    # Each goal is a jump of up to 90 mrad; dry friction leaves open where within 5.5 and 7.5 mrad of it a swing ends.
    longer, log = arm.sampled_every(0.09), log_every(0.09, arm)
    at_rest = torch.zeros(4, dtype=torch.float64)
    windows, fine = simulated(arm, log, at_rest)
    coarse, shown = simulated(longer, log, at_rest)
    assert coarse.step > 6.0 * windows.step
    assert float((fine - shown).abs()[windows.valid[:, :2]].max()) < 2 * 7.5e-3


def test_slow_samples_of_a_servo_that_friction_alone_ends_change_smoothly_with_its_stiffness(tmp_path):
    # Dead bands of 22 and 25 mrad: an undamped swing ends anywhere in them, depending on each of its turns.
    path = tmp_path / "undamped.xml"
    rough = STIFF_ARM.replace('damping="1" frictionloss="5"', 'frictionloss="20"')
    path.write_text(rough.replace('damping="0.2" frictionloss="1.5"', 'frictionloss="5"'))
    arm = any_system(str(path))
    slow, log = arm.sampled_every(0.09), log_every(0.09, arm)
    at_rest = torch.zeros(4, dtype=torch.float64)
    _, shown = simulated(slow, log, at_rest)
    _, stiffer = simulated(slow, log, at_rest, {"kp(shoulder)": 1.001})
    assert 0.0 < float((stiffer - shown).abs().max()) < 1e-3


def test_a_slow_log_sees_a_struck_servo_at_rest(arm):
    # The swing of 500 rad/s from 5 mrad off its goal is over at the next sample, and so is that from each new goal.
    struck = torch.tensor([5e-3, 5e-3, 0.0, 0.0], dtype=torch.float64)
    windows, shown = simulated(arm.sampled_every(0.09), log_every(0.09, arm), struck)
    late = shown[:, :, 3:] - windows.value[:, :2, 2:-1]
    assert float(late.abs().max()) < 9e-3  # within a dead band of 5.5 and 7.5 mrad


def test_effects_and_values_stay_with_the_longer_steps(arm):
    given = ExtendedSystem(arm, ("viscous(elbow)",), {"viscous(elbow).change": 0.2})
    slow = given.sampled_every(0.09)
    assert slow.longest_step == slow.base.longest_step > arm.longest_step
    assert [(p.name, p.value) for p in slow.parameters] == [(p.name, p.value) for p in given.parameters]
    assert given.sampled_every(0.002) is given

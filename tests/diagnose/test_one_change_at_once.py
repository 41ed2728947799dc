"""One changed parameter of a robot of many, named before causes are ranked on a refit that leaves only noise."""

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system

ARM = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/><joint damping="0.3"/></default>
<worldbody><body><joint name="yaw" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.03" mass="1.5"/>
<body pos="0 0 0.3"><joint name="lift" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.9"/>
<body pos="0.3 0 0"><joint name="bend" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0.2 0 0.05" size="0.02" mass="0.5"/>
</body></body></body></worldbody>
<actuator>{motors}</actuator></mujoco>
"""
JOINTS, H = ("yaw", "lift", "bend"), 0.01
STIFF, RATE = np.array([4.0, 20.0, 6.0]), np.array([0.8, 1.5, 0.4])


def written(gears):
    motors = "".join(
        f'<motor name="{j}_motor" joint="{j}" gear="{g}"/>' for j, g in zip(JOINTS, gears, strict=True)
    )
    return ARM.format(motors=motors)


def recorded(seconds=12.0, seed=0):
    """A log of three joints under a controller; the motor of the lift gives 0.7 of its torque."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(written((1.0, 0.7, 1.0)))
    data, t = mujoco.MjData(model), np.arange(0.0, seconds, H)
    slow = np.sin(np.outer(t, [1.3, 1.9, 2.7]) + np.arange(3.0))
    goals = 0.6 * slow + 0.2 * np.sin(np.outer(t, [4.1, 3.7, 5.3]))
    efforts, angles = [], []
    for goal in goals:
        angles.append(data.qpos.copy())
        efforts.append(STIFF * (goal - data.qpos) - RATE * data.qvel)
        for _ in range(round(H / model.opt.timestep)):
            data.ctrl[:] = efforts[-1]
            mujoco.mj_step(model, data)
    seen = np.array(angles) + 5e-4 * rng.standard_normal((len(t), 3))
    return Recording(
        {f"{j}_motor": Series(t, np.array(efforts)[:, k], "N m", "command") for k, j in enumerate(JOINTS)}
        | {f"q_{j}": Series(t, seen[:, k], "rad", "measurement") for k, j in enumerate(JOINTS)}
    )


@pytest.mark.study
def test_a_weak_motor_is_named_without_a_ranking_of_what_chance_has_left(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(written((1.0, 1.0, 1.0)))
    steps = []
    result = diagnose([recorded()], load_system(path), progress=steps.append)
    assert result.verdict == "cause"
    assert [cause.name for cause in result.causes] == ["changed(gain(lift_motor))"]
    (own,) = result.causes[0].parameters.values()
    assert own.low < 0.7 < own.high
    named = steps.index("one cause instead of many parameters: gain(lift_motor)")
    assert not any("fitting every cause" in step for step in steps[:named])

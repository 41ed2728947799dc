"""Trees simulated as MuJoCo does: against MuJoCo with the steps of the file, for each of its integrators."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.systems import ExtendedSystem, load_system
from deepkoco.systems.channel_delay import latest
from deepkoco.systems.rollout import RolloutInput

ARM = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.004" integrator="{}"><flag eulerdamp="{}"/></option>
<worldbody><body><joint name="a" axis="0 1 0" damping="0.6"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1.2"/>
  <body pos="0 0 -0.3"><joint name="b" axis="0 1 0" damping="0.2"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.6"/></body></body></worldbody>
<actuator><position name="hold_a" joint="a" kp="12" kv="0.8"/><motor name="m_b" joint="b"/></actuator></mujoco>
"""
FINE, SECONDS = 0.001, 4.0


def efforts(t):
    return np.stack([0.6 * np.sin(2.3 * t), 0.7 * np.sin(3.1 * t)], 1)


def in_mujoco(text):
    model = mujoco.MjModel.from_xml_string(text)
    data, path = mujoco.MjData(model), []
    for k in range(round(SECONDS / model.opt.timestep)):
        data.ctrl[:] = efforts(np.array([k * model.opt.timestep]))[0]
        mujoco.mj_step(model, data)
        path.append([*data.qpos, *data.qvel])
    return np.array(path)


def in_ours(system, step, fine=FINE):
    """Positions and speeds that a log shows at the ends of the engine's steps, under commands that hold over each."""
    timing, late = system.command_timing(0, system.default_parameters()), system.channel_delays({})
    behind = float(late.get(2, 0.0))  # of the speeds
    t = np.arange(0.0, SECONDS, fine)
    held = np.floor((t - (float(timing.delay) - behind) + 1e-9) / step) * step
    sent = np.where(held[:, None] >= 0.0, efforts(held), efforts(np.zeros(1)))
    start = (torch.zeros(1, 1, dtype=torch.float64),) * 4
    begin = [torch.from_numpy(sent[:, k].copy()).view(-1, 1, 1) for k in range(2)]
    p = system.default_parameters()
    given = RolloutInput(
        fine,
        start,
        start[0],
        begin,
        [torch.zeros_like(x) for x in begin],
        None,
        system.dry_friction_levels(p),
    )
    value = system.rollout(p).run(given).value
    every = round(step / fine)
    nodes = np.arange(every, len(t) + 1, every)
    places = [value[k][nodes, 0, 0].numpy() for k in range(2)]
    return np.stack([*places, *(value[k][nodes - round(behind / fine), 0, 0].numpy() for k in (2, 3))], 1)


@pytest.mark.parametrize(
    ("integrator", "flag"),
    [("Euler", "enable"), ("Euler", "disable"), ("implicitfast", "enable"), ("implicit", "enable")],
)
def test_a_tree_moves_as_in_the_steps_of_mujoco(tmp_path, integrator, flag):
    text = ARM.format(integrator, flag)
    (tmp_path / "arm.xml").write_text(text)
    machine, truth = load_system(tmp_path / "arm.xml"), in_mujoco(text)
    simulated = machine.with_engine()
    print(
        integrator,
        flag,
        np.sqrt(((in_ours(simulated, 0.004) - truth) ** 2).mean()),
        np.sqrt(((in_ours(machine, 0.004) - truth) ** 2).mean()),
        np.abs(truth).max(),
    )
    ours, others = (((in_ours(system, 0.004) - truth) ** 2).mean(0) ** 0.5 for system in (simulated, machine))
    assert (ours[:2] < 0.05 * others[:2]).all()
    assert (ours[2:] < 0.3 * others[2:]).all()
    assert ours[:2].max() < 1e-4 * np.abs(truth[:, :2]).max()


def test_a_tree_in_semi_implicit_steps_moves_as_rigid_bodies_do(tmp_path):
    text = ARM.format("Euler", "disable")
    (tmp_path / "arm.xml").write_text(text)
    machine, truth = load_system(tmp_path / "arm.xml"), in_mujoco(text)
    simulated = machine.with_engine("semi-implicit")
    assert (simulated.engine, simulated.engine_step) == ("semi-implicit", 0.004)
    assert any("Bullet" in note for note in simulated.notes)
    # Its steps are MuJoCo's own where nothing is implicit and nothing rubs.
    np.testing.assert_allclose(in_ours(simulated, 0.004, 0.004), truth, atol=1e-11)
    assert np.abs(in_ours(machine, 0.004) - truth)[:, :2].max() > 1e-3
    back = simulated.with_engine(None)
    assert (back.engine, back.notes) == (None, machine.notes)
    assert machine.with_engine("PhysX") is None


def test_steps_of_runge_kutta_are_those_of_a_machine(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format("RK4", "enable"))
    machine = load_system(tmp_path / "arm.xml")
    np.testing.assert_allclose(in_ours(machine.with_engine(), 0.004), in_ours(machine, 0.004), atol=1e-12)
    assert machine.engine is None
    assert machine.with_engine().engine == "MuJoCo"
    assert machine.with_engine().with_engine() is None


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 2.5])
def test_a_late_position_makes_commands_later_only_where_it_is_later_than_the_speeds_of_the_engine(
    tmp_path, share
):
    (tmp_path / "arm.xml").write_text(ARM.format("Euler", "enable"))
    base = load_system(tmp_path / "arm.xml").with_engine()
    p = base.default_parameters()
    shown = float(latest(base.channel_delays(p)))
    (name,) = [
        f"channel_delay({c.name})"
        for c, k in zip(base.measurements, base.measured_states, strict=True)
        if k == 0
    ]
    late = ExtendedSystem(base, (name,), {f"{name}.delay": share * shown})
    ours, theirs = (float(s.command_timing(0, s.default_parameters()).delay) for s in (late, base))
    assert shown > 0.0
    assert ours - theirs == pytest.approx(max(0.0, share - 1.0) * shown, abs=1e-15)

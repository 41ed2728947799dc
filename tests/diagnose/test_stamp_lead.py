"""Commands that act before their stamps: MuJoCo's integrator moves positions half a time step ahead of them."""

import mujoco
import numpy as np
import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.fit import cut_windows
from deepkoco.fit.simulate.simulator import predict
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, load_system, make_system
from tests.oracle.unit import hidden_log

STEP = 0.002  # MuJoCo's default [s]
PENDULUM = """<mujoco model="pendulum"><compiler angle="radian"/><worldbody><body name="link">
<joint name="hinge" type="hinge" axis="0 1 0" damping="0.02"/>
<inertial pos="0 0 -0.25" mass="0.5" diaginertia="0.003 0.003 0.0002"/></body></worldbody>
<actuator><motor name="m" joint="hinge" ctrllimited="true" ctrlrange="-3 3"/></actuator></mujoco>"""


def mujoco_log(seed: int, seconds: float = 12.0) -> Recording:
    """A healthy log at 100 Hz of MuJoCo at its default time step, with an encoder."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.opt.timestep = STEP
    data, rows = mujoco.MjData(model), round(100.0 * seconds)
    sent = np.repeat(rng.uniform(-1.5, 1.5, rows), rng.integers(10, 50, rows))[:rows]
    angle = np.zeros(rows)
    for i in range(rows):
        angle[i] = data.qpos[0]
        data.ctrl[0] = sent[i]
        mujoco.mj_step(model, data, round(0.01 / STEP))
    t, tick = np.arange(rows) / 100.0, 2.0 * np.pi / 16384
    shown = tick * np.round((angle + 2e-4 * rng.standard_normal(rows)) / tick)
    channels = {"m": Series(t, sent, "N m", "command"), "q_hinge": Series(t, shown, "rad", "measurement")}
    return Recording(channels, None, "pendulum", {})


@pytest.mark.study
def test_healthy_log_of_mujoco_at_its_default_step_misses_nothing(tmp_path):
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    result = diagnose([mujoco_log(20005)], load_system(path))
    assert result.verdict == "nothing"
    # Half a step is what MuJoCo's commands lead by: nothing that a fit would have to find.
    assert result.model.engine == "MuJoCo"
    assert result.unexplained["minor"] == []
    assert result.chi2_after < 1.3
    assert not result.moved


def test_lead_does_what_a_delay_of_the_other_sign_would_do():
    base = make_system("rod_pendulum")
    system = ExtendedSystem(base, ("actuation_delay", "stamp_lead"))
    windows = cut_windows([hidden_log("rod_pendulum", {}, "steps", 20006, 6.0)], base, 1.6)
    values = {p.name: torch.tensor(p.value, dtype=torch.float64) for p in system.parameters}
    late = torch.tensor([0.0, 0.004, 0.007], dtype=torch.float64)

    def shown(**change):
        return predict(system, windows, {**values, **change}, windows.state.repeat(3, 1, 1))

    delayed = shown(**{"actuation_delay.delay": late})
    both = shown(**{"actuation_delay.delay": late + 0.003, "stamp_lead.lead": torch.full_like(late, 0.003)})
    assert float((both - delayed).abs().max()) < 1e-9
    assert float((delayed[1] - delayed[0]).abs().max()) > 1e-4

"""The study of written files: every effect of the catalogue gets a dose, and the worst robot counts."""

import math

import mujoco
import numpy as np

from deepkoco.systems import load_system
from deepkoco.systems.effects import effects_of
from experiments.studies.diagnosis.write_back import _with_option, by_kind, cases, draw


def test_every_effect_and_every_kind_of_parameter_is_a_case(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(draw(30000, 0).xml)
    system = load_system(path)
    found = cases(system, np.random.default_rng(0))
    assert {c.kind for c in found if not c.kind.startswith("changed ")} == {
        placed.effect.name for placed in effects_of(system).values()
    }
    assert {c.kind for c in found} >= {"changed mass", "changed damping", "changed armature"}
    for case in found:
        given = {p.name: p.value for p in system.parameters}
        own = {p.name: p.value for p in case.system.parameters}
        nulls = {
            f"{placed.name}.{p.name}": p.value
            for placed in getattr(case.system, "effects", ())
            for p in placed.parameters(system)
        }
        assert own != given | nulls, case.name  # something is different


def test_file_gets_another_step_and_integrator():
    model = mujoco.MjModel.from_xml_string(_with_option(draw(30000, 0).xml, 1e-4, "RK4"))
    assert model.opt.timestep == 1e-4
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4


def test_worst_robot_counts_and_what_no_log_shows_does_not():
    row = {"kind": "gain", "left_out": ""}
    rows = [
        {**row, "held_out_error": 50.0, "share": 0.004, "share_own_step": 0.1},
        {**row, "held_out_error": 30.0, "share": 0.02, "share_own_step": 0.05},
        {**row, "held_out_error": 1.0, "share": 0.5, "share_own_step": 9.0},
        {"kind": "jitter", "left_out": "", "held_out_error": 0.0, "share": math.nan},
    ]
    assert by_kind(rows) == [
        {"kind": "gain", "robots": 2, "share": 0.02, "share_own_step": 0.1, "left_out": ""}
    ]

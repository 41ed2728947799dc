"""Columns as recorders of other makers name them, for an arm of two joints."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import doubts_of, propose, survey_log
from deepkoco.systems import load_system

T = 0.01 * np.arange(1500)
GOALS = [0.6 * np.sin(1.3 * T) + 0.2, 0.4 * np.sin(0.9 * T + 1.0) - 0.5]
Q = [np.interp(T - 0.05, T, goal) for goal in GOALS]
DQ = [np.gradient(q, 0.01) for q in Q]
TAU = [2.0 * np.gradient(dq, 0.01) + 0.3 * np.sign(dq) for dq in DQ]
TICK = 0.229 * 2 * np.pi / 60  # a unit of the speed of some servos [rad/s]


def arm(folder, actuator):
    drives = "".join(f'<{actuator} joint="{j}" ctrlrange="-3 3"/>' for j in ("shoulder", "elbow"))
    (folder / "arm.xml").write_text(
        f"""<mujoco model="arm"><compiler angle="radian"/><worldbody>
        <body><joint name="shoulder" axis="0 1 0" range="-3 3"/><geom size="0.05" pos="0.2 0 0"/>
        <body pos="0.3 0 0"><joint name="elbow" axis="0 1 0" range="-3 3"/><geom size="0.05" pos="0.2 0 0"/></body>
        </body></worldbody><actuator>{drives}</actuator></mujoco>"""
    )
    return load_system(folder / "arm.xml")


def numbered(pattern, values, first=0):
    return {pattern.format(k + first): value for k, value in enumerate(values)}


FRANKA = {
    **numbered("q_{}", Q),
    **numbered("q_d_{}", GOALS),
    **numbered("dq_{}", DQ),
    **numbered("tau_J_{}", [tau + 0.1 for tau in TAU]),
    **numbered("tau_J_d_{}", TAU),
}


@pytest.mark.parametrize(
    ("actuator", "time", "columns", "wanted"),
    [
        ("motor", "time", FRANKA, ("q_1", "dq_1", "tau_J_d_1")),
        ("position", "time", FRANKA, ("q_1", "dq_1", "q_d_1")),
        ("position", "t", {**numbered("state_{}", Q), **numbered("action_{}", GOALS)}, ("state_1", None, "action_1")),
        (
            "motor",
            "Time",
            {**numbered("theta{}", Q, 1), **numbered("thetadot{}", DQ, 1), **numbered("u{}", TAU, 1)},
            ("theta2", "thetadot2", "u2"),
        ),
    ],
)  # fmt: skip
def test_columns_of_other_recorders(tmp_path, actuator, time, columns, wanted):
    pd.DataFrame({time: T, **columns}).to_csv(tmp_path / "log.csv", index=False)
    fitting = propose(survey_log(open_log(tmp_path / "log.csv")), arm(tmp_path, actuator))
    found = {c.channel.name: None if c.column is None else c.column.name for c in fitting.proposal.choices}
    drive = next(c.channel.name for c in fitting.proposal.choices[::-1] if c.channel.kind == "command")
    assert fitting.doubt is None
    assert (found["q_elbow"], found["dq_elbow"], found[drive]) == wanted


def test_states_that_are_more_than_the_actions_are_no_positions(tmp_path):
    columns = {**numbered("state_{}", [*Q, *DQ]), **numbered("action_{}", GOALS)}
    pd.DataFrame({"t": T, **columns}).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(ValueError, match="no column fits the channel"):
        propose(survey_log(open_log(tmp_path / "log.csv")), arm(tmp_path, "position"))


def test_speeds_in_whole_steps_have_one_scale(tmp_path):
    slow = [0.15 * np.sin(0.3 * T), Q[1]]
    speeds = [np.round(np.gradient(q, 0.01) / TICK) for q in slow]
    columns = {**numbered("pos{}", slow), **numbered("goal{}", slow), **numbered("vel{}", speeds)}
    pd.DataFrame({"t": T, **columns}).to_csv(tmp_path / "log.csv", index=False)
    fitting = propose(survey_log(open_log(tmp_path / "log.csv")), arm(tmp_path, "position"))
    scales = {c.channel.name: c.scale for c in fitting.proposal.choices}
    assert scales["dq_shoulder"] == scales["dq_elbow"] == pytest.approx(TICK, rel=0.02)


def test_the_only_column_that_grows_evenly_is_the_time(tmp_path):
    columns = {"IPOC": 8 * np.arange(len(T)) + 4000, **numbered("q{}", Q), **numbered("goal{}", GOALS)}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    survey = survey_log(open_log(tmp_path / "log.csv"))
    proposal = propose(survey, arm(tmp_path, "position")).proposal
    assert proposal.time == "ms"
    assert any(
        '"IPOC" has no unit in its name; its steps suggest ms' in doubt
        for doubt in doubts_of(survey, proposal)
    )

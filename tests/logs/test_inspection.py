"""`deepkoco inspect`: survey of a log, proposed mapping, and possible mistakes."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from deepkoco.cli.command_line import main
from deepkoco.excitation.record import record
from deepkoco.logs import read_log
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import NoProposalError, doubts_of, propose, survey_log
from deepkoco.logs.inspect.names import read_name
from deepkoco.systems import one_joint
from deepkoco.unit import make_unit

sys.path.append(str(Path(__file__).parents[1] / "graph"))
from tests.logs.log_writers import WRITERS
from tests.oracle.own_robots import CartPoleUnit


@pytest.fixture(scope="module")
def motion() -> pd.DataFrame:
    """A torque pendulum under a random two-level torque: t, torque, theta, omega, one row per measurement."""
    log = record(
        make_unit("torque_pendulum", seed=1), "prbs", 8.0, control_rate=50.0, clock="simulated", seed=1
    )
    theta, omega = log.channels["theta"], log.channels["omega"]
    held = log.channels["torque"].hold(theta.t)
    return pd.DataFrame({"t": theta.t, "torque": held, "theta": theta.value, "omega": omega.value})


def proposed(path: Path, frame: pd.DataFrame, system: str = "torque_pendulum"):
    frame.to_csv(path, index=False)
    found = survey_log(open_log(path))
    fitting = propose(found, system)
    return found, fitting.proposal, {c.channel.name: c for c in fitting.proposal.choices}


@pytest.mark.parametrize(
    "names",
    [
        {"t": "t", "theta": "pos", "omega": "vel", "torque": "tau_cmd"},
        {"t": "time_s", "theta": "jointAngle", "omega": "jointSpeed", "torque": "u"},
        {"t": "stamp", "theta": "q1", "omega": "dq1", "torque": "effort1"},
        {"t": "t", "theta": "position[shoulder]", "omega": "velocity[shoulder]", "torque": "command.data"},
        {"t": "t", "theta": "a", "omega": "b", "torque": "c"},
    ],
)
def test_propose_finds_columns_by_name_or_by_values(tmp_path, motion, names):
    frame = motion.rename(columns=names).assign(
        temperature=21.5, noise=np.random.default_rng(0).normal(size=len(motion))
    )
    shuffled = frame[sorted(frame.columns, reverse=True)]
    _, proposal, choices = proposed(tmp_path / "log.csv", shuffled)
    for channel in ("theta", "omega", "torque"):
        assert choices[channel].column is not None, channel
        assert choices[channel].column.name == names[channel]
    assert proposal.time == "s"


def test_propose_finds_an_unnamed_command_by_the_motion_it_explains(tmp_path, motion):
    rng = np.random.default_rng(0)
    frame = motion.rename(columns={"torque": "in_1"}).assign(in_2=rng.choice([-1.0, 1.0], len(motion)))
    frame = frame.rename(columns={"in_1": "x_input", "in_2": "y_input"})
    _, _, choices = proposed(tmp_path / "log.csv", frame)
    assert choices["torque"].column.name == "x_input"
    assert any("explains" in reason for reason in choices["torque"].reasons)


@pytest.mark.parametrize(
    ("factors", "units"),
    [
        ({"theta": 180 / np.pi}, {"theta": "deg", "omega": "rad/s"}),
        ({"theta": 180 / np.pi, "omega": 180 / np.pi}, {"theta": "deg", "omega": "deg/s"}),
        ({"omega": 30 / np.pi}, {"theta": "rad", "omega": "rpm"}),
        ({"t": 1e3}, {"theta": "rad", "omega": "rad/s"}),
    ],
)
def test_propose_derives_units_from_the_ratio_of_angle_and_speed(tmp_path, motion, factors, units):
    frame = motion.assign(theta=2 * motion["theta"], omega=2 * motion["omega"])
    frame = frame.assign(**{name: frame[name] * factor for name, factor in factors.items()})
    found, proposal, choices = proposed(tmp_path / "log.csv", frame)
    if len(factors) < 2:  # only the range distinguishes both in degrees from both in radians
        assert {name: choices[name].unit for name in units} == units
    assert proposal.time == ("ms" if "t" in factors else "s")
    text = " ".join(doubts_of(found, proposal))
    if len(factors) == 1:
        assert "check it" in text


def test_propose_uses_units_in_names_and_doubts_report_contradictions(tmp_path, motion):
    degrees = motion.rename(columns={"theta": "theta_deg"}).assign(theta_deg=np.degrees(motion["theta"]))
    _, _, choices = proposed(tmp_path / "right.csv", degrees[["t", "torque", "theta_deg", "omega"]])
    assert (choices["theta"].unit, choices["theta"].stated) == ("deg", True)
    wrong = motion.rename(columns={"theta": "theta [deg]", "omega": "omega [rad/s]"})
    found, proposal, _ = proposed(tmp_path / "wrong.csv", wrong)
    assert any(
        "not by 1" in doubt and "the speed is in deg/s" in doubt for doubt in doubts_of(found, proposal)
    )


def test_propose_assigns_columns_to_two_joints(tmp_path):
    t = 0.01 * np.arange(800)
    q1, q2 = np.sin(2 * t), 0.5 * np.cos(5 * t)
    frame = pd.DataFrame(
        {"t": t, "dq2": np.gradient(q2, t), "q2": q2, "tau2": np.sin(9 * t), "tau1": np.cos(7 * t)}
    )
    frame = frame.assign(q1=q1, dq1=np.gradient(q1, t))
    _, _, choices = proposed(tmp_path / "log.csv", frame, "two_link_arm")
    named = {name: choice.column.name for name, choice in choices.items()}
    wanted = {
        "angle_1": "q1",
        "angle_2": "q2",
        "speed_1": "dq1",
        "speed_2": "dq2",
        "torque_1": "tau1",
        "torque_2": "tau2",
    }
    assert named == wanted


def test_survey_counts_gaps_resets_bursts_duplicates_and_constants(tmp_path, motion):
    first, second = motion.iloc[:300], motion.iloc[300:].assign(t=lambda f: f["t"] - f["t"].iloc[0])
    frame = pd.concat([first.drop(index=range(100, 150)), second], ignore_index=True)
    frame = frame.assign(run=np.repeat([0, 1], [250, len(second)]), dead=3.0)
    frame.loc[[10, 11, 12, 40], "omega"] = np.nan
    frame.loc[20, "t"] = frame.loc[19, "t"]
    frame.loc[60, "theta"] = 1e9
    found, proposal, _ = proposed(tmp_path / "log.csv", frame)
    clock = found.clocks[""][0]
    assert (clock.gaps, clock.duplicates, clock.resets, clock.counter) == (2, 1, (250,), "run")
    assert found.runs == 2
    columns = {c.name: c for c in found.columns}
    omega = columns["omega"]
    assert (omega.missing, omega.bursts, omega.longest_burst) == (4, 2, 3)
    assert columns["dead"].kind == "constant"
    assert columns["run"].kind == "counter"
    assert columns["theta"].far == 1
    text = " ".join(doubts_of(found, proposal))
    for part in (
        "decreases at line 252",
        'the log has 2 runs, which the column "run" counts',
        "repeats a stamp 1 times",
        '"dead" never changes',
    ):
        assert part in text


@pytest.mark.parametrize("name", ["json.mcap", "ros1.bag", "ros2_sqlite"])
def test_inspect_writes_a_mapping_of_a_bag_that_read_log_accepts(tmp_path, motion, name, capsys):
    if name != "json.mcap":
        pytest.importorskip("rosbags")
    path = WRITERS[name](tmp_path / name, {k: motion[k].to_numpy() for k in motion})
    out = tmp_path / "map.yaml"
    command = [
        "inspect",
        str(path),
        "--system",
        "torque_pendulum",
        "--out",
        str(out),
        "--plot",
        str(tmp_path / "a.png"),
    ]
    assert main(command) == 0
    assert "velocity[shoulder]" in capsys.readouterr().out
    system = one_joint("torque_pendulum")
    channels = [(c.name, c.unit, c.kind) for c in (system.command, *system.measurements)]
    recording = read_log(path, out, channels=channels)
    np.testing.assert_array_equal(recording.channels["theta"].value, motion["theta"])
    np.testing.assert_array_equal(recording.channels["torque"].value, motion["torque"])
    assert (tmp_path / "a.png").stat().st_size > 10_000
    drawn = pd.read_csv(tmp_path / "a_data.csv")
    assert "/joint_states position[shoulder]" in set(drawn["column"])
    assert main(command) == 2
    assert "map.yaml: exists" in capsys.readouterr().err


def test_inspect_json_contains_columns_and_proposal(tmp_path, motion, capsys):
    motion.to_csv(tmp_path / "log.csv", index=False)
    assert main(["inspect", str(tmp_path / "log.csv"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["format"] == "CSV"
    assert {c["name"] for c in content["columns"]} == {"t", "torque", "theta", "omega"}
    assert content["proposal"]["channels"]["theta"]["column"] == "theta"
    # The zero of a rod pendulum is upright, where gravity pushes and does not pull.
    assert content["proposal"]["system"] == "torque_pendulum"
    assert content["proposal"]["alike"] == []


def test_inspect_out_needs_system_if_several_fit_equally_well(tmp_path, capsys):
    """Two joints with two torques: by the names and the motion, an arm or a double pendulum."""
    t = 0.01 * np.arange(600)
    columns = {"t": t}
    for k in (1, 2):
        columns |= {f"pos{k}": np.sin(k * t), f"vel{k}": k * np.cos(k * t), f"tau{k}": np.sin(3.3 * k * t)}
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    assert main(["inspect", str(tmp_path / "log.csv"), "--out", str(tmp_path / "m.yaml")]) == 2
    assert "equally well; give --system" in capsys.readouterr().err
    assert not (tmp_path / "m.yaml").exists()


def test_inspect_reports_a_sidecar_that_contradicts_the_values(tmp_path, motion, capsys):
    path = tmp_path / "log.csv"
    motion.assign(theta=np.degrees(motion["theta"])).to_csv(path, index=False)
    channels = {"theta": {"column": "theta", "unit": "rad", "kind": "measurement"}}
    channels |= {"omega": {"column": "omega", "unit": "rad/s", "kind": "measurement"}}
    path.with_suffix(".yaml").write_text(
        yaml.safe_dump({"time": {"column": "t", "unit": "s"}, "channels": channels})
    )
    assert main(["inspect", str(path)]) == 2
    shown = capsys.readouterr()
    assert "theta [rad]" in shown.out
    assert "the angle is in deg" in shown.err
    assert shown.err.count("\n") == 1


def test_propose_refuses_a_table_without_time(tmp_path):
    pd.DataFrame({"name": ["a", "b"], "mean_ms": [3.0, 2.0]}).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(NoProposalError, match="no column is a time"):
        propose(survey_log(open_log(tmp_path / "a.csv")))


@pytest.mark.parametrize(
    ("name", "unit", "number", "joint"),
    [
        ("theta_deg", "deg", None, None),
        ("pos [rad]", "rad", None, None),
        ("tau_Nm", "N m", None, None),
        ("time_ms", "ms", None, None),
        ("vel (deg/s)", "deg/s", None, None),
        ("tau_meas2", None, 2, None),
        ("position[shoulder]", None, None, "shoulder"),
        ("joints.position[2]", None, 2, "2"),
        ("s", None, None, None),
        ("angle_1", None, 1, None),
        ("pos_m_min", None, None, None),
        ("q_min", None, None, None),
        ("v_m/min", "m/min", None, None),
        ("v [m/min]", "m/min", None, None),
        ("v_rev_s", "rev/s", None, None),
        ("time_min", "min", None, None),
    ],
)
def test_read_name_splits_unit_number_and_joint(name, unit, number, joint):
    hints = read_name(name)
    assert (hints.unit, hints.number, hints.joint) == (unit, number, joint)


def test_propose_maps_a_switch_only_by_its_name(tmp_path):
    """A servo's goal, its switch, and a torque that is neither."""
    t = np.arange(0.0, 6.0, 0.016)
    goal = np.sin(1.5 * t) + 0.4 * np.sin(7.0 * t)
    frame = pd.DataFrame(
        {
            "t": t,
            "goal_position": goal,
            "position": np.convolve(goal, np.ones(5) / 5.0, "same"),
            "torque_demand": 0.9 * np.gradient(goal),
            "torque_enable": np.ones(len(t)),
        }
    )
    _, _, choices = proposed(tmp_path / "log.csv", frame, "servo_pendulum")
    assert choices["goal"].column.name == "goal_position"
    assert choices["theta"].column.name == "position"
    assert choices["enable"].column is None or choices["enable"].column.name == "torque_enable"
    frame["torque_enable"] = (t < 2.0).astype(float)
    _, _, choices = proposed(tmp_path / "other.csv", frame, "servo_pendulum")
    assert choices["enable"].column.name == "torque_enable"


def test_doubts_accept_units_of_joints_that_move_together(tmp_path):
    t = np.arange(0.0, 8.0, 0.004)
    wave = np.sin(3.0 * t) + 0.3 * np.sin(8.0 * t)
    rate = 3.0 * np.cos(3.0 * t) + 2.4 * np.cos(8.0 * t)
    extra, faster = 0.2 * np.sin(5.0 * t), np.cos(5.0 * t)
    frame = pd.DataFrame(
        {
            "t": t,
            "pos_meas1": -0.3 * wave + extra,
            "pos_meas2": wave,
            "vel_meas1": -0.3 * rate + faster,
            "vel_meas2": rate,
            "tau_con1": np.sin(2.0 * t),
            "tau_con2": np.sin(4.0 * t),
        }
    )
    survey, fitting, choices = proposed(tmp_path / "log.csv", frame, "double_pendulum")
    assert {c.column.name for c in choices.values()} == set(frame.columns) - {"t"}
    assert not [d for d in doubts_of(survey, fitting) if "times the integral" in d]


def test_a_log_of_a_robot_that_is_not_known_fits_none_of_the_systems(tmp_path, capsys):
    log = CartPoleUnit().log(tmp_path, seconds=10.0)
    log.with_suffix(".yaml").unlink()
    assert main(["inspect", str(log)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "none of the" in said
    assert "--system my_robot.py:CLASS" in said
    assert "proposed for" not in said
    example = Path(__file__).parents[2] / "docs" / "examples" / "cart_pole.py"
    out = tmp_path / "mapping.yaml"
    assert main(["inspect", str(log), "--system", f"{example}:CartPole", "--out", str(out)]) == 0
    mapping = yaml.safe_load(out.read_text())
    assert mapping["system"] == "cart_pole"
    assert {name: c["column"] for name, c in mapping["channels"].items()} == {
        "position": "position",
        "angle": "angle",
        "force": "force",
    }

"""Inspection of logs without a command: a free motion, or a driven one whose command nobody recognises."""

import numpy as np
import pandas as pd
import pytest

from deepkoco.cli.command_line import main
from deepkoco.logs.read_logs import read_logs
from deepkoco.logs.recording import LogError
from deepkoco.systems import any_system

T = np.arange(0.0, 8.0, 0.01)
FREE = """<robot name="swing"><link name="world"/><link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="continuous"><parent link="world"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>"""


def test_a_log_of_a_free_swing_needs_no_command_where_every_command_has_a_default(tmp_path):
    (tmp_path / "swing.urdf").write_text(FREE)
    log = tmp_path / "log.csv"
    pd.DataFrame({"t": T, "pivot_deg": 20.0 * np.exp(-0.05 * T) * np.cos(5.4 * T)}).to_csv(log, index=False)
    system = str(tmp_path / "swing.urdf")
    assert main(["inspect", str(log), "--system", system, "--out", str(tmp_path / "log.yaml")]) == 0
    (found,) = read_logs(log, system)
    assert list(found.channels) == ["q_pivot"]
    assert "no command: read as a free motion" in found.warnings


@pytest.fixture
def driven(tmp_path):
    """A driven log of the same joint, in which nothing but the values of "duty" tells the command."""
    (tmp_path / "swing.urdf").write_text(FREE)
    drive = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, len(T) // 40 + 1), 40)[: len(T)]
    angle = 20.0 * np.sin(2.0 * T) + 5.0 * np.sin(3.1 * T)
    pd.DataFrame({"t": T, "pivot_deg": angle, "duty": drive, "row": range(len(T))}).to_csv(
        tmp_path / "log.csv", index=False
    )
    return tmp_path / "log.csv", str(tmp_path / "swing.urdf")


def test_a_driven_log_whose_command_has_no_telling_name_is_not_taken_for_a_free_swing(
    driven, tmp_path, capsys
):
    log, system = driven
    assert main(["inspect", str(log), "--system", system, "--out", str(tmp_path / "log.yaml")]) == 2
    assert '"duty" may be one' in capsys.readouterr().err
    # What was found is kept, and no command takes it for the mapping of a free swing.
    assert "CHOOSE" in (tmp_path / "log.yaml").read_text()
    assert main(["diagnose", str(log), "--system", system, "--out", str(tmp_path / "report")]) == 2
    assert "CHOOSE" in capsys.readouterr().err


def test_a_sidecar_without_a_command_names_the_columns_that_are_not_used(driven):
    log, system = driven
    angle = {"column": "pivot_deg", "unit": "deg", "kind": "measurement"}
    sidecar = {"time": {"column": "t", "unit": "s"}, "channels": {"q_pivot": angle}}
    (found,) = read_logs(log, system, mapping=sidecar)
    assert 'no command: read as a free motion; columns not used: "duty"' in found.warnings


def test_a_free_swing_may_show_that_its_command_is_zero(driven, tmp_path):
    _, system = driven
    (command,) = (c.name for c in any_system(system).commands)
    sidecar = {
        "time": {"column": "t", "unit": "s"},
        "channels": {
            "q_pivot": {"column": "q", "unit": "rad", "kind": "measurement"},
            command: {"column": "u", "unit": "N m", "kind": "command"},
        },
    }
    swing = np.exp(-0.05 * T) * np.cos(5.4 * T)
    for value, name in ((0.0, "free"), (0.3, "held")):
        pd.DataFrame({"t": T, "q": swing, "u": value}).to_csv(tmp_path / f"{name}.csv", index=False)
    (found,) = read_logs(tmp_path / "free.csv", system, mapping=sidecar)
    assert set(found.channels) == {"q_pivot", command}
    with pytest.raises(LogError, match="is constant"):
        read_logs(tmp_path / "held.csv", system, mapping=sidecar)

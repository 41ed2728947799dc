"""The study on real logs, on logs of a unit laid out in the same way."""

import json

import numpy as np
import pandas as pd

from deepkoco.unit import make_unit
from deepkoco.unit.record import record
from experiments.real_logs import main


def write_logs(folder):
    """Four logs of a torque pendulum with dry friction, in the columns of the real ones."""
    folder.mkdir()
    names = ("energy_shaping", "sac", "ddp_pd", "direct_collocation_pd")
    for seed, (name, excitation) in enumerate(zip(names, ("steps", "chirp", "prbs", "steps"), strict=True)):
        spec = make_unit("torque_pendulum", effects={"coulomb": {"torque": 0.15}}, seed=seed)
        log = record(spec, excitation, 5.0, control_rate=100.0, clock="simulated", seed=seed)
        theta, omega, torque = (log.channels[n] for n in ("theta", "omega", "torque"))
        # The study takes a torque for a sample in the middle of its time; a command begins at its stamp.
        columns = {
            "t": theta.t,
            "pos": theta.value,
            "vel": omega.value,
            "tau_meas": torque.hold(theta.t + 0.001),
        }
        pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False)


def test_friction_is_named_and_pays(tmp_path):
    write_logs(tmp_path / "dfki_pendulum")
    printed = []
    assert main(["--data", str(tmp_path), "--log", "dfki_pendulum", "--json"], printed.append) == 0
    result = json.loads(printed[0])
    assert list(result)[:7] == [
        "verdict",
        "first",
        "class",
        "rmse_baseline",
        "rmse_refit",
        "rmse_extended",
        "seconds",
    ]
    assert result["rmse_extended"] < 0.5 * result["rmse_refit"]
    assert np.isfinite(result["seconds"])


def test_missing_data_is_one_line(tmp_path, capsys):
    assert main(["--data", str(tmp_path), "--log", "dfki_pendulum"]) == 2
    assert "energy_shaping.csv: no such file" in capsys.readouterr().err

"""EMPS: simulate the whole record under the logged force, with found and with published parameters side by side.

python -m experiments.studies.diagnosis.logs_of_others.emps_record --data FOLDER --model report/model.yaml --out FOLDER

Nothing but the state at the start is fitted. A force moves a car without a spring, so an error of the force adds up:
the record is simulated as a whole, and once more in windows of 1.5 s.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.fit import Noise, cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import ExtendedSystem, load_system
from experiments.studies.diagnosis.yaml_studies import read_study

STUDY = Path(__file__).parent / "emps.yaml"
# Janot, Gautier, Brunot (2019): inverse model and least squares; their offset is on the other side of the equation.
PUBLISHED = {"mass": 95.1089, "viscous": 203.5034, "coulomb.torque": 20.3935, "torque_bias.effort": 3.1648}
LENGTHS = (1.5, 24.5)  # of the windows [s]
THIN = 10  # every tenth sample is compared


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a table and a figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of estimation.csv")
    parser.add_argument("--model", type=Path, required=True, help="model.yaml that a diagnosis wrote")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args(arguments)
    study = read_study(STUDY)
    system = load_system(study.system)
    models = {
        "as given": system,
        "published": ExtendedSystem(system, ("coulomb", "torque_bias"), PUBLISHED),
        "diagnosed": load_system(args.model),
    }
    log = study.read(args.data, next(iter(study.questions.values())).train[0])
    table, paths = [], {}
    for length in LENGTHS:
        windows = cut_windows([log], system, length, (Noise(1e-5, 0.01),), cover=True)
        keep = np.arange(windows.t.shape[2]) % THIN == 0
        for name, model in models.items():
            start = baseline_from(model, windows)
            fit = FitProblem(start.system, windows).evaluate(start.values, name)
            error = fit.residual[:, 0, keep].numpy() * windows.noise[0].sd
            valid = windows.valid[:, 0, keep].numpy()
            table.append((f"{length:g}", name, f"{1e3 * np.sqrt((error[valid] ** 2).mean()):.4g}"))
            paths[length, name] = (windows.t[0, 0, keep].numpy() + windows.t0[0], error[0])
    args.out.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([("window_s", "model", "rms_mm"), *table])
    write_whole_text(args.out / "emps_record.csv", text.getvalue())
    figure, axis = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    for name in ("published", "diagnosed"):
        t, error = paths[LENGTHS[-1], name]
        axis.plot(t, 1e3 * error, label=name)
    axis.set(xlabel="time [s]", ylabel="measured minus simulated [mm]")
    axis.legend()
    figure.savefig(args.out / "emps_record.png", dpi=150)
    sys.stdout.write(text.getvalue())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

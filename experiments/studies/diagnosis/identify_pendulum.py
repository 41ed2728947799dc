"""Study: a pendulum's parameters, hidden delays and state from 21 s of log, as in thesis ch. 4.

python -m experiments.studies.diagnosis.identify_pendulum [--units 5] [--seed 0] [--out results/identify] [--json]

The unit is simulated by `deepkoco.unit` (own integrator, true sticking). Its parameters are drawn up to 20 % from the
nominal ones, commands act 7 ms late, and the angle comes from a camera whose frames are stamped 8 ms late; the speed
comes from the motor's encoder at once. Fitted are four parameters and both delays. Then the state is estimated on a
second log, by the filter alone (the newest belief taken for now) and with forward prediction, against the noise-free
motion.

Each unit is written as soon as it is done: a study that was stopped goes on where it was when called again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch

from deepkoco.excitation.record import record
from deepkoco.fit import (
    Belief,
    DelayedEstimator,
    Identification,
    cut_windows,
    fit,
    system_derivative,
)
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.threads import one_thread
from deepkoco.logs.recording import Recording, Series
from deepkoco.output.picture import house_style
from deepkoco.output.whole_file import whole_file
from deepkoco.systems import make_system
from deepkoco.unit.unit_file import make_unit

SECONDS = 21.0
ACTUATION, CAMERA = 0.007, 0.008  # [s]
FITTED = ("mass", "motor_constant", "viscous", "coulomb")
DELAYS = {"actuation_delay.delay": ACTUATION, "theta.delay": CAMERA}
SPREAD = 0.2  # of the true parameters around the nominal ones
# Stretches of the log, in which the initial state is found [s]. Where the last one followed that of 14 s at once, one
# more unit of five ended in a state that does not lead through the log.
STRETCHES = tuple(np.arange(1.0, SECONDS - 0.25, 0.5).tolist())
FRAME = 2  # a frame of the camera for so many samples of the encoder
NOISE_DENSITY = (0.0, 0.5)  # of angle [rad2/s] and speed [rad2/s3] in the estimator


def unit_logs(true: dict[str, float], seed: int) -> tuple[Recording, Recording]:
    """One log as the sensors give it, and the same motion without noise and camera delay."""
    logs = []
    for noise in ({}, {"noise_sd": {"theta": 0.0, "omega": 0.0}}):
        spec = make_unit(
            "pendulum",
            parameters=true,
            effects={"actuation_delay": {"delay": ACTUATION}},
            sensor={"rate_hz": 200, **noise},
            seed=seed,
        )
        logs.append(record(spec, "steps", SECONDS, clock="simulated", seed=seed))
    measured, exact = logs
    theta = measured.channels["theta"]
    frames = Series(theta.t[::FRAME] + CAMERA, theta.value[::FRAME], theta.unit, theta.kind)
    return replace(measured, channels={**measured.channels, "theta": frames}), exact


def reconstruction(found: Identification, log: Recording) -> float:
    """Error of the angle when the whole log is simulated at once from one initial state [rad]."""
    state = None
    # A swinging pendulum forgets its start within seconds: the fit of a short stretch leads to that of a longer one.
    for seconds in STRETCHES:
        # All stretches begin at the start of the log; windows of a fit leave out a share of their length there.
        windows = cut_windows([log], found.system, seconds, cover=True).take(np.array([0]))
        problem = FitProblem(found.system, windows, ("theta",))
        state, _ = problem.fit_states(found.fit.values, windows.state if state is None else state, 30)
    assert state is not None
    theta = np.array([[found.fit.values[n] for n in problem.names]])
    predicted = problem.predict(theta, state[None], problem.zeros.none()[None])[0]
    valid = windows.valid[:, 0] & (windows.t[:, 0] >= CAMERA)
    return float(((predicted - windows.value)[:, 0][valid] ** 2).mean().sqrt())


def state_errors(found: Identification, log: Recording, exact: Recording) -> tuple[float, float]:
    """Mean squared errors of the angle at the instants at which commands act: filtered only, and predicted."""
    values = {n: torch.tensor(v, dtype=torch.float64) for n, v in found.fit.values.items()}
    actuation, camera = (found.estimates[n].value for n in DELAYS)
    plain = make_system("pendulum")
    estimator = DelayedEstimator(
        system_derivative(plain, values),
        plain.ideal_measurement,
        torch.diag(torch.tensor(NOISE_DENSITY, dtype=torch.float64)),
        torch.tensor([n.sd for n in found.request.windows.noise], dtype=torch.float64),
        kept=6,
    )
    command, theta, omega = (log.channels[n] for n in ("voltage", "theta", "omega"))
    begin = float(command.t[0])
    first = torch.tensor([[theta.value[0], omega.value[0]]], dtype=torch.float64)
    spread = torch.diag(torch.tensor([0.05, 0.5], dtype=torch.float64))[None]
    since, still = torch.tensor([begin - 0.02], dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64)
    memory = estimator.start(Belief(first, spread), since, still, commands=8)
    events = [(t, 0, theta.value[i], np.nan, camera) for i, t in enumerate(theta.t)]
    events += [(t, 0, np.nan, v, 0.0) for t, v in zip(omega.t, omega.value, strict=True)]
    events += [(t, 1, u, 0.0, actuation) for t, u in zip(command.t, command.value, strict=True)]
    truth, rows = exact.channels["theta"], []
    for t, kind, a, b, delay in sorted(events):
        now = torch.tensor([t], dtype=torch.float64)
        if kind == 0:
            value = torch.tensor([[a, b]], dtype=torch.float64)
            memory = estimator.receive(memory, now, value, delay)
            continue
        filtered = float(memory.newest()[0].mean[0, 0])
        predicted = float(estimator.estimate(memory, now, actuation).mean[0, 0])
        true = float(np.interp(t + ACTUATION, truth.t, truth.value))
        rows.append((filtered - true, predicted - true))
        memory = estimator.send(memory, now, torch.tensor([[a]], dtype=torch.float64), actuation)
    errors = np.array(rows)[25:]  # after the filter has settled
    return float((errors[:, 0] ** 2).mean()), float((errors[:, 1] ** 2).mean())


def study(seed: int) -> dict:
    """One unit: what was hidden, what was found, what it took."""
    rng = np.random.default_rng(seed)
    nominal = make_system("pendulum")
    true = {n: nominal.parameter(n).value * (1.0 + rng.uniform(-SPREAD, SPREAD)) for n in FITTED}
    log, _ = unit_logs(true, 2 * seed)
    began, processor = time.perf_counter(), time.process_time()
    found = fit([log], "pendulum", [*FITTED, *DELAYS])
    seconds, processor = time.perf_counter() - began, time.process_time() - processor
    second, exact = unit_logs(true, 2 * seed + 1)
    with one_thread():
        whole = reconstruction(found, log)
        filtered, predicted = state_errors(found, second, exact)
    row = {
        "seed": seed,
        "fit_seconds": seconds,
        "fit_cpu_seconds": processor,
        "simulations": found.convergence.simulations,
        "converged": found.convergence.converged,
        "reconstruction_rad": whole,
        "filtered_mse_rad2": filtered,
        "predicted_mse_rad2": predicted,
    }
    for name, value in {**true, **DELAYS}.items():
        e = found.estimates[name]
        row |= {f"{name} true": value, f"{name} found": e.value, f"{name} low": e.low, f"{name} high": e.high}
    return row


def summary(table: pd.DataFrame) -> dict:
    """Largest errors over the units, and medians of the rest."""
    column = {name: table[name].to_numpy(dtype=float) for name in table.columns}
    relative = {n: float(np.abs(column[f"{n} found"] / column[f"{n} true"] - 1.0).max()) for n in FITTED}
    late = {n: float(np.abs(column[f"{n} found"] - column[f"{n} true"]).max()) for n in DELAYS}
    return {
        "units": len(table),
        "largest_relative_error": relative,
        "largest_delay_error_s": late,
        "reconstruction_rad_median": float(np.median(column["reconstruction_rad"])),
        "filtered_over_predicted_mse_median": float(
            np.median(column["filtered_mse_rad2"] / column["predicted_mse_rad2"])
        ),
        "fit_seconds_median": float(np.median(column["fit_seconds"])),
        "fit_cpu_seconds_median": float(np.median(column["fit_cpu_seconds"])),
    }


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write the units found so far, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        table.to_csv(partial, index=False, lineterminator="\n", float_format="%.8g")


def draw(table: pd.DataFrame, path: Path) -> None:
    """Error of every parameter and delay, unit by unit."""
    with house_style():
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.2))
        for axis, names, scale in ((left, FITTED, None), (right, tuple(DELAYS), 1e3)):
            for i, name in enumerate(names):
                true, found, low, high = (
                    table[f"{name} {part}"].to_numpy(dtype=float) for part in ("true", "found", "low", "high")
                )
                factor = 100.0 / true if scale is None else scale
                reach = np.array([found - low, high - found]) * factor
                at = i + np.linspace(-0.25, 0.25, len(table)) if len(table) > 1 else np.array([i])
                axis.errorbar(at, (found - true) * factor, yerr=reach, fmt="o", markersize=4)
            axis.set_xticks(
                range(len(names)), [n.replace("_delay.delay", "").replace(".delay", "") for n in names]
            )
            axis.axhline(0.0, color="#222222", lw=1)
        left.set_ylabel("error of the parameter [%]")
        right.set_ylabel("error of the delay [ms]")
        figure.savefig(path, metadata={"Software": None})
        plt.close(figure)


def main(arguments: list[str] | None = None) -> int:
    """Run the study over several units."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--units", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for units.csv and its figure; units in it are kept")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if args.units < 1:
        parser.error("--units: at least one")
    path = None if args.out is None else args.out / "units.csv"
    rows = [] if path is None or not path.exists() else pd.read_csv(path).to_dict("records")
    known = {row["seed"] for row in rows}
    for seed in range(args.seed, args.seed + args.units):
        if seed not in known:
            rows.append(study(seed))
            if path is not None:
                write_table(pd.DataFrame(rows), path)
    table = pd.DataFrame(rows).sort_values("seed", ignore_index=True)
    result = summary(table)
    if path is not None:
        write_table(table, path)
        draw(table, path.with_name("errors.png"))
    sys.stdout.write(
        json.dumps(result, indent=2) + "\n" if args.json else f"{pd.Series(result).to_string()}\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

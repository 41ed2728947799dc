"""Eight parameters and three delays of a quadrotor from 21 s of flight, on units that the fit does not know.

    python -m experiments.studies.diagnosis.identify_quadrotor --out results/identify/quadrotor --seeds 0 1 2 3 4

The units share no code with the simulator: their motion is integrated in steps of 1 ms here. A simple position
controller flies them between random places, and noise of a motion-capture system is added to what it measures.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.fit import fit
from deepkoco.logs.recording import Recording, Series
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import whole_file
from deepkoco.systems import make_system
from experiments.plumbing.provenance import as_markdown

PARAMETERS = ("mass", "drag", "drag_up", "roll_gain", "pitch_gain", "roll_lag", "pitch_lag", "motor_lag")
DELAYS = {"thrust_delay": 0.015, "roll_delay": 0.034, "pitch_delay": 0.009}  # those of the thesis [s]
SPREAD = 0.2  # true parameters lie within this share of the nominal ones
DELAY_SPREAD = 0.006  # and delays within this of those above [s]
SECONDS, STEP = 21.0, 1e-3  # [s]
CONTROL, SENSOR = 20, 10  # steps between two commands, and between two measurements
NOISE = (0.002, 0.02)  # position [m], velocity [m/s]
EARTH = 9.81  # [m/s2]
NOMINAL_MASS = 0.033  # [kg]
SHAKING = (1.5, 1.5, 6.0)  # standard deviation of the wanted acceleration, anew for each command [m/s2]
MOST = np.array([3.5, 3.5, 7.0])  # of a wanted acceleration [m/s2]
WANTED = (0.02, 1e-3)  # relative error of a parameter, error of a delay [s]


class Flight:
    """A unit in flight: what it is sent and what is measured of it.

    Args:
        true: Its parameters and delays.
        seed: Of the places it is flown to and of the noise.
    """

    def __init__(self, true: Mapping[str, float], seed: int) -> None:
        self.true, self.rng = true, np.random.default_rng(seed)
        self.sent: list[tuple[float, tuple[float, float, float]]] = []
        self.measured: list[tuple[float, np.ndarray]] = []

    def fly(self, seconds: float = SECONDS) -> Recording:
        """Fly and return the log."""
        p, state = self.true, np.zeros(6)
        hover = (NOMINAL_MASS * EARTH, 0.0, 0.0)
        acting = list(
            hover
        )  # thrust, roll and pitch before gains; held since before the log, as a fit takes it
        lags = (p["motor_lag"], p["roll_lag"], p["pitch_lag"])
        delays = (p["thrust_delay"], p["roll_delay"], p["pitch_delay"])
        place = np.zeros(3)
        for k in range(round(seconds / STEP)):
            now = k * STEP
            if k % SENSOR == 0:
                noise = np.repeat(NOISE, 3) * self.rng.standard_normal(6)
                self.measured.append((now, state + noise))
            if k % (40 * CONTROL) == 0:
                place = self.rng.uniform(-1.0, 1.0, 3)
            if k % CONTROL == 0:
                self.sent.append((now, self._decide(state, place) if k else hover))
            targets = [self._held(i, now - delay, hover[i]) for i, delay in enumerate(delays)]
            # Middle of the step: exact for a held target, second order for the motion.
            middle = [
                u + (a - u) * math.exp(-0.5 * STEP / lag)
                for a, u, lag in zip(acting, targets, lags, strict=True)
            ]
            half = state + 0.5 * STEP * self._slope(state, acting)
            state = state + STEP * self._slope(half, middle)
            acting = [
                u + (a - u) * math.exp(-STEP / lag) for a, u, lag in zip(acting, targets, lags, strict=True)
            ]
        return self._recording()

    def _held(self, index: int, since: float, before: float) -> float:
        """Mean of what was sent to one command over a step that begins at ``since`` [s]."""
        mean, until = 0.0, since + STEP
        for sent, command in reversed(self.sent[-12:]):
            start = max(sent, since)
            if start < until:
                mean, until = mean + command[index] * (until - start) / STEP, start
            if until <= since:
                return mean
        return mean + before * (until - since) / STEP

    def _decide(self, state: np.ndarray, place: np.ndarray) -> tuple[float, float, float]:
        """Thrust, roll and pitch of a position controller of the nominal quadrotor, with some shaking."""
        wanted = 2.0 * (place - state[:3]) - 1.8 * state[3:] + self.rng.normal(0.0, SHAKING)
        x, y, z = np.clip(wanted, -MOST, MOST) + np.array([0.0, 0.0, EARTH])
        size = math.sqrt(x * x + y * y + z * z)
        thrust = float(np.clip(NOMINAL_MASS * size, 0.0, 0.6))
        return (
            thrust,
            float(np.clip(-math.asin(y / size), -0.5, 0.5)),
            float(np.clip(math.atan2(x, z), -0.5, 0.5)),
        )

    def _slope(self, state: np.ndarray, acting: Sequence[float]) -> np.ndarray:
        p, (thrust, roll, pitch) = self.true, acting
        turn_x = _turn(p["roll_gain"] * roll, (1, 2))
        turn_y = _turn(p["pitch_gain"] * pitch, (2, 0))
        push = turn_y @ turn_x @ np.array([0.0, 0.0, thrust])
        drag = np.array([p["drag"], p["drag"], p["drag_up"]]) * state[3:]
        return np.concatenate([state[3:], (push - drag) / p["mass"] - np.array([0.0, 0.0, EARTH])])

    def _recording(self) -> Recording:
        system = make_system("quadrotor")
        stamps = np.array([t for t, _ in self.sent])
        commands = np.array([u for _, u in self.sent])
        times, values = np.array([t for t, _ in self.measured]), np.array([x for _, x in self.measured])
        channels = {
            c.name: Series(stamps, commands[:, i], c.unit, "command") for i, c in enumerate(system.commands)
        }
        channels |= {
            c.name: Series(times, values[:, i], c.unit, "measurement")
            for i, c in enumerate(system.measurements)
        }
        return Recording(channels, system="quadrotor")


def _answered(
    acting: Sequence[float], targets: Sequence[float], lags: Sequence[float], time: float
) -> list[float]:
    """What acts after a time under first-order lags [s] of held targets."""
    return [u + (a - u) * math.exp(-time / lag) for a, u, lag in zip(acting, targets, lags, strict=True)]


def _turn(angle: float, plane: tuple[int, int]) -> np.ndarray:
    """Rotation by an angle in a plane of two axes."""
    matrix, (a, b) = np.eye(3), plane
    matrix[a, a] = matrix[b, b] = math.cos(angle)
    matrix[a, b], matrix[b, a] = -math.sin(angle), math.sin(angle)
    return matrix


def hidden(seed: int) -> dict[str, float]:
    """True values of a unit."""
    rng, nominal = np.random.default_rng(seed), make_system("quadrotor")
    true = {n: nominal.parameter(n).value * (1.0 + rng.uniform(-SPREAD, SPREAD)) for n in PARAMETERS}
    return true | {
        n: max(value + rng.uniform(-DELAY_SPREAD, DELAY_SPREAD), 0.0) for n, value in DELAYS.items()
    }


def study(seed: int, window: float | None) -> dict:
    """One unit: what was hidden, what was found, what it took."""
    true = hidden(seed)
    log = Flight(true, seed + 1000).fly()
    processor = time.process_time()
    found = fit([log], "quadrotor", [*PARAMETERS, *DELAYS], window=window)
    row = {
        "seed": seed,
        "cpu_seconds": time.process_time() - processor,
        "converged": found.convergence.converged,
    }
    for name, value in true.items():
        e = found.estimates[name]
        row |= {f"{name} true": value, f"{name} found": e.value, f"{name} low": e.low, f"{name} high": e.high}
    return row


def errors(table: pd.DataFrame) -> pd.DataFrame:
    """Largest error over the units of each parameter, relative, and of each delay [s]; and how often it is inside."""
    rows = []
    for name in (*PARAMETERS, *DELAYS):
        true, found, low, high = (
            table[f"{name} {part}"].to_numpy(dtype=float) for part in ("true", "found", "low", "high")
        )
        late = name in DELAYS
        error = np.abs(found - true) if late else np.abs(found / true - 1.0)
        inside = int(((low <= true) & (true <= high)).sum())
        rows.append(
            {
                "name": name,
                "largest": float(error.max()),
                "median": float(np.median(error)),
                "reached": int((error <= WANTED[late]).sum()),
                "inside": inside,
                "units": len(table),
            }
        )
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame) -> Figure:
    """Error of every parameter and delay, unit by unit."""
    with house_style():
        figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.2), width_ratios=(8, 3), layout="constrained")
        for panel, names, late in ((panels[0], PARAMETERS, False), (panels[1], tuple(DELAYS), True)):
            for i, name in enumerate(names):
                true, found, low, high = (
                    table[f"{name} {part}"].to_numpy(dtype=float) for part in ("true", "found", "low", "high")
                )
                factor = np.full(len(true), 1e3) if late else 100.0 / true
                at = i + np.linspace(-0.25, 0.25, len(table)) if len(table) > 1 else np.array([i])
                reach = np.array([found - low, high - found]) * factor
                panel.errorbar(at, (found - true) * factor, yerr=reach, fmt="o", markersize=4)
            panel.set_xticks(range(len(names)), [n.replace("_", "\n") for n in names], fontsize=7)
            for edge in (-1.0, 1.0):
                panel.axhline(edge * (1.0 if late else 2.0), color="#999999", linestyle="--", linewidth=1)
            panel.axhline(0.0, color="#222222", linewidth=1)
        panels[0].set_ylabel("error of the parameter [%]")
        panels[1].set_ylabel("error of the delay [ms]")
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description="Parameters and delays of hidden quadrotors from 21 s of flight."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument(
        "--window", type=float, default=None, help="length of a window [s]; default: the fit's own"
    )
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in args.seeds:
        rows.append(study(seed, args.window))
        table = pd.DataFrame(rows)
        with whole_file(args.out / "units.csv") as partial:
            table.to_csv(partial, index=False, lineterminator="\n", float_format="%.8g")
        (args.out / "errors.png").write_bytes(as_png(draw(table)))
        print(errors(table).to_string(index=False), flush=True)
    print(
        f"\nprocessor seconds of a fit: {table['cpu_seconds'].min():.1f} to {table['cpu_seconds'].max():.1f}\n"
    )
    print(as_markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())

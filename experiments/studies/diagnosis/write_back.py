"""Does the written MJCF move as our model? Every effect of the catalogue, in plain MuJoCo.

python -m experiments.studies.diagnosis.write_back --out results/write_back [--seed 30000] [--robots 4]

For each robot, effect and changed parameter: our simulation with the effect is the unit. The held-out error is that of
the model as given on windows of 1 s of this unit, each from the unit's own state. The error of the file is that of a
plain MuJoCo rollout of the written file on the same windows. Both are root mean squares over the position channels,
each in units of its sensor's noise. The goal is a file whose error is at most 1 % of the held-out error.

MuJoCo's implicit integrators are of first order: at 2 ms a motion is late by about 1 ms, with or without any effect.
The column ``share`` is therefore of files with RK4 and 0.1 ms; ``share_own_step`` is of files with the integrator and
the 2 ms of the given file.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import re
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from deepkoco.fit import Noise
from deepkoco.fit.data.windows import CommandSeries, Windows
from deepkoco.fit.simulate.simulator import predict
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import ExtendedSystem, System, load_system
from deepkoco.systems.effects import effects_of
from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.tree_system import TreeSystem
from deepkoco.systems.trees.write_back import extended_mjcf
from tests.oracle.mujoco_robots import Robot, cart_pole, random_arm

mujoco = mujoco_library()

SECONDS, HOLD, RATE = 1.0, 0.1, 100.0  # of a window, of a command, of the sensors
WINDOWS = 3
OURS = 2e-3  # our integration step [s]
FINE = 1e-4  # time step of the files that show the equations, with MuJoCo's RK4 [s]
GOAL = 0.01
SEEN = 3.0  # held-out error, in units of the sensors' noise, below which no log shows an effect
COLUMNS = ("robot", "what", "kind", "held_out_error", "file_error", "share", "share_own_step", "left_out")


class Case(NamedTuple):
    """One change of a robot.

    Attributes:
        name: Effect with its joint, or ``changed(PARAMETER)``.
        kind: Effect, or kind of the parameter.
        system: The robot with it.
    """

    name: str
    kind: str
    system: System


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table, and print the counts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=30000)
    parser.add_argument("--robots", type=int, default=4)
    args = parser.parse_args(arguments)
    began, rows = time.process_time(), []
    for number in range(args.robots):
        rows += study_robot(draw(args.seed + number, number), args.seed + number)
        sys.stdout.write(f"robot {number}: {len(rows)} rows, {time.process_time() - began:.0f} CPU s\n")
        sys.stdout.flush()
    args.out.mkdir(parents=True, exist_ok=True)
    write_whole_text(args.out / "write_back.csv", _table(rows))
    kinds = by_kind(rows)
    write_whole_text(args.out / "by_kind.csv", _table(kinds))
    held = [k for k in kinds if not k["left_out"]]
    good = [k for k in kinds if k["share"] <= GOAL]
    sys.stdout.write(
        f"{len(good)} of {len(kinds)} kinds within {GOAL:.0%}; MJCF can hold {len(held)} of them, "
        f"{sum(k['share'] <= GOAL for k in held)} within; {time.process_time() - began:.0f} CPU s\n"
    )
    return 0


def draw(seed: int, number: int) -> Robot:
    """Robots in turn: arm with motors, arm with servos, cart-pole."""
    rng = np.random.default_rng([seed, 1])
    if number % 3 == 2:
        return cart_pole(rng)
    return random_arm(rng, 3, "motor" if number % 3 == 0 else "position")


def study_robot(robot: Robot, seed: int) -> list[dict[str, Any]]:
    """Rows of one robot."""
    rng = np.random.default_rng([seed, 2])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        path.write_text(_with_option(robot.xml, FINE, "RK4"))
        system = load_system(path)
        assert isinstance(system, TreeSystem)
        windows, starts = excitation(robot, system, rng)
        given = shown(system, windows, starts)
        rows = []
        for case in cases(system, rng):
            try:
                row = compare(case, system, windows, starts, given)
            except (ValueError, ArithmeticError) as error:
                row = {"share": math.inf, "left_out": f"{type(error).__name__}: {error}"}
            rows.append({"robot": robot.name, "what": case.name, "kind": case.kind, **row})
        return rows


def compare(
    case: Case, system: System, windows: Windows, starts: np.ndarray, given: np.ndarray
) -> dict[str, Any]:
    """Errors of the given model and of the written file."""
    noise = np.array([c.noise_sd for c in system.measurements[: system.joints]])[:, None]
    unit = shown(case.system, windows, starts)
    written = extended_mjcf(case.system)
    fine = rolled_out(written.xml, windows, starts)
    coarse = rolled_out(_with_option(written.xml, 2e-3, "implicitfast"), windows, starts)
    held_out, *errors = (
        float(np.sqrt((((other - unit) / noise) ** 2).mean())) for other in (given, fine, coarse)
    )
    share = [error / held_out if held_out > 0.0 else math.nan for error in errors]
    return {
        "held_out_error": held_out,
        "file_error": errors[0],
        "share": share[0],
        "share_own_step": share[1],
        "left_out": "; ".join(text.split(": ", 1)[1] for text in written.left_out),
    }


def cases(system: TreeSystem, rng: np.random.Generator) -> list[Case]:
    """Each effect at one of its sites, and each kind of parameter at one of its owners."""
    sites: dict[str, list[str]] = {}
    for name, placed in effects_of(system).items():
        sites.setdefault(placed.effect.name, []).append(name)
    found = []
    for kind, names in sites.items():
        chosen = names[int(rng.integers(len(names)))]
        declared = {p.name: p for p in effects_of(system)[chosen].parameters(system)}
        values = {f"{chosen}.{n}": v for n, v in dose(kind, declared, system).items()}
        found.append(Case(chosen, kind, ExtendedSystem(system, (chosen,), values)))
    owners: dict[str, list[str]] = {}
    for p in system.parameters:
        if p.value != 0.0:
            owners.setdefault(p.name.partition("(")[0], []).append(p.name)
    for kind, names in owners.items():
        chosen = names[int(rng.integers(len(names)))]
        p = system.parameter(chosen)
        value = min(max(1.5 * p.value, p.low), p.high)
        found.append(
            Case(f"changed({chosen})", f"changed {kind}", ExtendedSystem(system, (), {chosen: value}))
        )
    return found


def dose(kind: str, declared: Mapping[str, Any], system: System) -> dict[str, float]:
    """Values of an effect that a log shows clearly: a share of the usual size that the effect declares."""
    values = {
        n: p.value if p.value not in (0.0, 1.0) else min(p.value + 0.3 * p.prior_sd, p.high)
        for n, p in declared.items()
    }
    if kind == "learned":
        return {**{n: p.value for n, p in declared.items()}, "v": values["v"], "constant": values["constant"]}
    special: dict[str, dict[str, float]] = {
        "actuation_delay": {"delay": 0.023},
        "sensing_delay": {"delay": 0.023},
        "lag": {"time_constant": 0.04},
        "saturation": {"limit": 0.3 * declared["limit"].value} if "limit" in declared else {},
        "rate_limit": {"limit": 0.1 * declared["limit"].prior_sd} if "limit" in declared else {},
        "gain": {"factor": 0.7},
        "unit_slip": {"factor": 0.7},
        "channel_slip": {"factor": 1.1},
        "scaled": {"factor": 1.5},
        "body_mass": {"factor": 1.5},
        "sensor_scale": {"factor": 1.1},
        "sensor_crosstalk": {"share": 0.1},
        "channel_scale": {"factor": 1.1},
        "gain_curve": {"curvature": 2.0 * declared["curvature"].prior_sd} if "curvature" in declared else {},
        "gear_play": {"width": 2.0 * declared["width"].prior_sd} if "width" in declared else {},
        "tilt": {n: 0.1 for n in declared},
    }
    return {**values, **special.get(kind, {})}


def excitation(robot: Robot, system: System, rng: np.random.Generator) -> tuple[Windows, np.ndarray]:
    """Windows under random steps of the commands, and their start states (W, S)."""
    ticks, sizes = round(SECONDS / HOLD), np.array(robot.sizes)
    commands = []
    for _ in range(WINDOWS):
        levels = (
            rng.uniform(-1.0, 1.0, (ticks, len(sizes))) * (0.6 if robot.drive == "motor" else 0.5) * sizes
        )
        levels[0] = 0.0  # filters and delays of both simulations begin alike
        commands.append(
            CommandSeries(HOLD * np.arange(ticks), levels if levels.shape[1] > 1 else levels[:, 0])
        )
    samples, channels = round(SECONDS * RATE), len(system.measurements)
    t = torch.arange(1, samples + 1, dtype=torch.float64) / RATE
    t = t.expand(WINDOWS, channels, samples).contiguous()
    joints = system.joints
    starts = np.concatenate(
        [rng.uniform(-0.4, 0.4, (WINDOWS, joints)), rng.uniform(-0.3, 0.3, (WINDOWS, joints))], 1
    )
    noise = tuple(Noise(c.noise_sd, 1.0) for c in system.measurements)
    windows = Windows(
        tuple(commands), np.arange(WINDOWS), np.zeros(WINDOWS), OURS, round(SECONDS / OURS), t,
        torch.zeros_like(t), torch.ones_like(t, dtype=torch.bool), noise, torch.from_numpy(starts),
        np.zeros(WINDOWS, dtype=bool), tuple(range(channels)),
    )  # fmt: skip
    return windows, starts


def shown(system: System, windows: Windows, starts: np.ndarray) -> np.ndarray:
    """Positions (W, J, M) that the sensors of our simulation show."""
    measured = predict(system, windows, system.default_parameters(), torch.from_numpy(starts)[None])[0]
    return measured[:, : system.joints].numpy()


def rolled_out(xml: str, windows: Windows, starts: np.ndarray) -> np.ndarray:
    """The same in plain MuJoCo, by the file alone: positions (W, J, M)."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    joints, step = starts.shape[1] // 2, model.opt.timestep
    per, hold = round(1.0 / RATE / step), round(HOLD / step)
    result = np.empty((len(starts), joints, round(SECONDS * RATE)))
    for w, start in enumerate(starts):
        data = mujoco.MjData(model)
        data.qpos[:joints], data.qvel[:joints] = start[:joints], start[joints:]
        values = windows.commands[w].value.reshape(-1, model.nu)
        for i in range(result.shape[2] * per):
            data.ctrl[:] = values[min(i // hold, len(values) - 1)]
            mujoco.mj_step(model, data)
            if (i + 1) % per == 0:
                result[w, :, (i + 1) // per - 1] = data.qpos[:joints]
    return result


def by_kind(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The worst share of each kind over the robots on which a log shows it."""
    kinds: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        kinds.setdefault(row["kind"], []).append(row)
    result = []
    for kind, own in kinds.items():
        known = [r for r in own if r.get("held_out_error", math.inf) >= SEEN]
        if not known:
            continue
        worst = max(known, key=lambda r: r["share"])
        result.append(
            {
                "kind": kind,
                "robots": len(known),
                "share": worst["share"],
                "share_own_step": max(r.get("share_own_step", math.inf) for r in known),
                "left_out": worst["left_out"],
            }
        )
    return sorted(result, key=lambda r: r["share"])


def _with_option(xml: str, step: float, integrator: str) -> str:
    """The file with another time step and integrator."""
    given = re.search(r"<option[^>]*>", xml)
    assert given is not None
    option = re.sub(r'(timestep|integrator)="[^"]*"', "", given.group())
    new = option.replace("<option", f'<option timestep="{step:g}" integrator="{integrator}"', 1)
    return xml[: given.start()] + new + xml[given.end() :]


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    columns = [c for c in dict.fromkeys(c for row in rows for c in row)]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})
    return text.getvalue()


if __name__ == "__main__":
    sys.exit(main())

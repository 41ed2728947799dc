"""Study: logs of public arms given as URDF, moved by MuJoCo with drives of which the file says nothing.

python -m experiments.studies.diagnosis.public_arms --robots FOLDER --out OUT [--cases 12] [--seed 0]

Each case takes two joints of an arm; the others are held. The unit has rotors and dampings that its URDF does not
state, masses that are off by up to 3 %, and at most one hidden cause at one of the joints. The diagnosis gets the URDF
and a log of 20 s at 200 Hz, as a user would give them. A killed study goes on where it was.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.logs.recording import Recording, Series
from deepkoco.output.whole_file import whole_file
from deepkoco.systems import load_system
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.model_file import read_spec
from deepkoco.systems.trees.mujoco_library import mujoco_library

ARMS = {
    "panda_description/urdf/panda.urdf": ("panda_joint2", "panda_joint4"),
    "ur_description/urdf/ur5_robot.urdf": ("shoulder_lift_joint", "elbow_joint"),
    "z1_description/urdf/z1.urdf": ("joint2", "joint3"),
    "xarm_description/urdf/xarm7.urdf": ("joint2", "joint4"),
    "kinova_description/robots/kinova.urdf": ("j2s6s200_joint_2", "j2s6s200_joint_3"),
    "ur_description/urdf/ur10_robot.urdf": ("shoulder_lift_joint", "elbow_joint"),
}
HIDDEN = ("coulomb", "nothing", "actuation_delay")
RATE, SECONDS = 200.0, 20.0
STEP = 5e-5  # of MuJoCo [s]; with 0.25 ms its error is as large as the noise of the encoders
ROTOR = (0.5, 2.0)  # inertia of a rotor, over the least inertia that its joint moves
FADING = (1.0, 8.0)  # damping, over that inertia with the rotor [1/s]
SPREAD = 0.03  # largest relative error of a mass
FRICTION = (0.03, 0.1)  # dry friction, over the load of the joint in this motion
DELAY = (0.01, 0.03)  # [s]
AMPLITUDE = 0.25  # of each of three sines [rad]
NOISE = (2e-4, 5e-3)  # of angles [rad] and speeds [rad/s]
COLUMNS: tuple[str, ...] = (
    "robot",
    "hidden",
    "joint",
    "size",
    "verdict",
    "named",
    "value",
    "low",
    "high",
    "chi2",
    "seconds",
)
MUJOCO = mujoco_library()


@dataclass(frozen=True)
class Case:
    """One unit: an arm of the list, and what it hides.

    Attributes:
        robot: Path of its file, as in `ARMS`.
        hidden: One of `HIDDEN`.
        joint: Joint at which it is hidden.
        seed: Of all draws.
    """

    robot: str
    hidden: str
    joint: str
    seed: int


def draw_case(seed: int, index: int) -> Case:
    """Return a case, which follows from seed and number alone."""
    rng = np.random.default_rng([seed, index])
    robot = list(ARMS)[index % len(ARMS)]
    hidden = HIDDEN[(index + index // len(ARMS)) % len(HIDDEN)]
    return Case(robot, hidden, str(rng.choice(ARMS[robot])), int(rng.integers(2**31)))


def settings_of(path: Path, moving: Sequence[str]) -> Path:
    """Write the settings that hold all joints but two beside a file, and return the file."""
    spec = MUJOCO.MjSpec.from_file(str(path))
    held = [joint.name for joint in spec.joints if joint.name not in moving]
    path.with_name(f"{path.stem}.parameters.yaml").write_text(f"held: {held}\n".replace("'", '"'))
    return path


def record(case: Case, path: Path, arm: TreeSystem) -> tuple[Recording, float]:
    """Move the unit, and return its log and the size of what it hides [N m or s]."""
    rng, names = np.random.default_rng(case.seed), arm.joint_names
    spec, _ = read_spec(path, arm.held)
    inertia = np.array([p.high for p in arm.parameters if p.name.startswith("armature(")]) / 20.0
    rotor = inertia * rng.uniform(*ROTOR, len(names))
    damping = (inertia + rotor) * rng.uniform(*FADING, len(names))
    for body in spec.bodies:
        body.mass = body.mass * (1.0 + rng.uniform(-SPREAD, SPREAD))
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 0
    for k, name in enumerate(names):
        joint = spec.joint(name)
        joint.armature, joint.damping, joint.limited = rotor[k], [damping[k], 0.0, 0.0], False
        joint.solref_friction = [4.0 * STEP, 1.0]  # as stiff as the step allows: a joint at rest sticks
        spec.add_actuator(name=name, target=name, trntype=MUJOCO.mjtTrn.mjTRN_JOINT)
    spec.option.timestep, spec.option.integrator = STEP, MUJOCO.mjtIntegrator.mjINT_RK4
    late = [0] * len(names)
    bare = _moved(spec, arm, rng.bit_generator.state, late)
    size = 0.0
    j = names.index(case.joint)
    if case.hidden == "coulomb":
        size = float(rng.uniform(*FRICTION)) * float(np.abs(bare[2][:, j]).max())
        spec.joint(case.joint).frictionloss += size
    if case.hidden == "actuation_delay":
        late[j] = round(float(rng.uniform(*DELAY)) / STEP)
        size = late[j] * STEP
    t, state, torque = _moved(spec, arm, rng.bit_generator.state, late)
    noise = np.repeat(NOISE, len(names))
    state = state + noise * rng.standard_normal(state.shape)
    channels = {c.name: Series(t, state[:, i], c.unit, "measurement") for i, c in enumerate(arm.measurements)}
    channels |= {c.name: Series(t, torque[:, i], c.unit, "command") for i, c in enumerate(arm.commands)}
    return Recording(channels), size


def _moved(
    spec: Any, arm: TreeSystem, generator: Any, late: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,), states (n, 4) and torques (n, 2) under a controller; each torque acts some steps late."""
    rng = np.random.default_rng()
    rng.bit_generator.state = generator
    model = spec.compile()
    data, count = MUJOCO.MjData(model), model.nv
    low, high = np.array([[joint.low, joint.high] for joint in arm.tree.joints]).T
    reach = np.isfinite(low) & np.isfinite(high)
    middle = np.where(reach, 0.5 * (low + high), 0.0) + rng.uniform(-0.5, 0.5, count)
    phase = rng.uniform(0.0, 2.0 * math.pi, (count, 3))
    data.qpos[:] = middle
    MUJOCO.mj_forward(model, data)
    mass = np.zeros((count, count))
    MUJOCO.mj_fullM(model, data, mass)
    stiffness = 100.0 * mass.diagonal()
    steps = round(1.0 / (RATE * STEP))
    t = np.arange(round(SECONDS * RATE)) / RATE
    state, torque = np.zeros((len(t), 2 * count)), np.zeros((len(t), count))
    sent = np.zeros((len(t) * steps + max(late), count))
    for k, now in enumerate(t):
        goal = middle + AMPLITUDE * np.sin(np.array([1.3, 2.9, 5.1]) * now + phase).sum(-1)
        torque[k] = stiffness * (goal - data.qpos) - 0.14 * stiffness * data.qvel + data.qfrc_bias
        state[k] = np.concatenate([data.qpos, data.qvel])
        for j, wait in enumerate(late):
            sent[k * steps + wait : (k + 1) * steps + wait, j] = torque[k, j]
        for step in range(steps):
            data.ctrl[:] = sent[k * steps + step]
            MUJOCO.mj_step(model, data)
    return t, state, torque


def row_of(case: Case, size: float, found: Diagnosis, seconds: float) -> dict[str, str | float]:
    """Return the row of a case."""
    values = found.causes[0].parameters if found.causes else {}
    first = next(iter(values.values()), None)
    return {
        "robot": Path(case.robot).stem,
        "hidden": case.hidden,
        "joint": case.joint if case.hidden != "nothing" else "",
        "size": f"{size:.4g}" if size else "",
        "verdict": found.verdict,
        "named": " + ".join(cause.name for cause in found.causes if cause.name != found.verdict),
        "value": "" if first is None else f"{first.value:.4g}",
        "low": "" if first is None else f"{first.low:.4g}",
        "high": "" if first is None else f"{first.high:.4g}",
        "chi2": f"{found.chi2_after:.3f}",
        "seconds": f"{seconds:.0f}",
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--robots", type=Path, required=True, help="folder of the robots of example-robot-data"
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    table = args.out / "public_arms.csv"
    rows: list[dict[str, Any]] = []
    if table.is_file():
        with table.open(newline="") as file:
            rows = list(csv.DictReader(file))
    args.out.mkdir(parents=True, exist_ok=True)
    for index in range(len(rows), args.cases):
        case = draw_case(args.seed, index)
        path = settings_of(args.robots / case.robot, ARMS[case.robot])
        arm = load_system(path)
        assert isinstance(arm, TreeSystem)
        log, size = record(case, path, arm)
        began = time.process_time()
        rows.append(row_of(case, size, diagnose([log], arm), time.process_time() - began))
        with whole_file(table) as part, part.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
        print(" ".join(f"{key}={value}" for key, value in rows[-1].items()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

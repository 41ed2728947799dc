"""Study: logs of robots that MuJoCo simulates with the options that a file has by default, diagnosed without a sidecar.

python -m experiments.studies.diagnosis.simulated_robots --out OUT [--cases 20] [--seed 0]

A user who has no hardware yet hides an error in the simulation of his own robot. Four robots (an arm with motors, a
pan-tilt head with servos, a crane, a leg on a rail) keep MuJoCo's time step, integrator and soft friction. Sizes of
robots, motions, noise and what is hidden follow from the seed; every value of the unit differs a little from the file.
A killed study goes on where it was.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.systems import load_system
from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.plumbing.provenance import provenance
from experiments.studies.diagnosis.rows import go_on

ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="{damping_shoulder}" frictionloss="{friction_shoulder}"/>
<geom type="capsule" fromto="0 0 0 0 0 -{length}" size="0.03" mass="{mass}"/>
<body name="fore" pos="0 0 -{length}"><joint name="elbow" axis="0 1 0" damping="{damping_elbow}"
frictionloss="{friction_elbow}"/><geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="{light}"/>
</body></body></worldbody><actuator><motor name="m_shoulder" joint="shoulder" gear="{gear_shoulder}"/>
<motor name="m_elbow" joint="elbow" gear="{gear_elbow}"/></actuator></mujoco>"""
HEAD = """<mujoco model="head"><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
<body name="base"><joint name="pan" axis="0 0 1" damping="{damping_pan}" frictionloss="{friction_pan}" armature="0.01"/>
<geom type="box" size="0.05 0.04 0.06" mass="{mass}"/><body name="camera" pos="0 0 0.1">
<joint name="tilt" axis="0 1 0" damping="{damping_tilt}" frictionloss="{friction_tilt}" armature="0.008"/>
<geom type="box" size="0.06 0.03 0.03" pos="0.04 0 0.02" mass="{light}"/></body></body></worldbody><actuator>
<position name="s_pan" joint="pan" kp="{kp_pan}" kv="0.4"/>
<position name="s_tilt" joint="tilt" kp="{kp_tilt}" kv="0.3"/>
</actuator></mujoco>"""
CRANE = """<mujoco model="crane"><compiler angle="radian"/><option integrator="RK4"/><worldbody><body name="trolley">
<joint name="rail" type="slide" axis="1 0 0" damping="{damping_rail}" frictionloss="{friction_rail}"/>
<geom type="box" size="0.1 0.05 0.05" mass="{mass}"/><body name="load">
<joint name="swing" axis="0 1 0" damping="0.02"/><geom type="sphere" size="0.05" pos="0 0 -{length}" mass="{light}"/>
</body></body></worldbody><actuator><motor name="drive" joint="rail" gear="{gear_rail}"/></actuator></mujoco>"""
LEG = """<mujoco model="leg"><compiler angle="radian"/><worldbody><body name="thigh">
<joint name="hip" axis="0 1 0" damping="{damping_hip}" frictionloss="{friction_hip}" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -{length}" size="0.03" mass="{mass}"/><body name="shank" pos="0 0 -{length}">
<joint name="knee" type="slide" axis="0 0 1" damping="{damping_knee}" frictionloss="{friction_knee}" armature="0.3"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="{light}"/></body></body></worldbody><actuator>
<motor name="m_hip" joint="hip" gear="{gear_hip}"/><position name="s_knee" joint="knee" kp="{kp_knee}" kv="15"/>
</actuator></mujoco>"""
SLIDES = ("rail", "knee")


@dataclass(frozen=True)
class Robot:
    """A robot whose sizes follow from a seed.

    Attributes:
        text: Its file, with places for its values.
        joints: Names of its joints.
        driven: Joint of each actuator -> largest command of its motion, in the actuator's unit.
        usual: Range of each value of the file.
    """

    text: str
    joints: tuple[str, ...]
    driven: Mapping[str, float]
    usual: Mapping[str, tuple[float, float]]


Span = tuple[float, float]


def _of_joint(joint: str, damping: Span, friction: Span) -> dict[str, Span]:
    return {f"damping_{joint}": damping, f"friction_{joint}": friction}


ROBOTS = {
    "arm": Robot(
        ARM, ("shoulder", "elbow"), {"shoulder": 0.5, "elbow": 0.25},
        {"length": (0.25, 0.4), "mass": (0.8, 1.6), "light": (0.4, 0.9), "gear_shoulder": (5.0, 9.0),
         "gear_elbow": (2.5, 5.0), **_of_joint("shoulder", (0.2, 0.5), (0.1, 0.4)),
         **_of_joint("elbow", (0.08, 0.2), (0.05, 0.2))},
    ),
    "head": Robot(
        HEAD, ("pan", "tilt"), {"pan": 1.2, "tilt": 0.8},
        {"mass": (0.4, 0.8), "light": (0.3, 0.7), "kp_pan": (10.0, 20.0), "kp_tilt": (8.0, 16.0),
         **_of_joint("pan", (0.06, 0.15), (0.05, 0.2)), **_of_joint("tilt", (0.05, 0.12), (0.05, 0.15))},
    ),
    "crane": Robot(
        CRANE, ("rail", "swing"), {"rail": 0.9},
        {"length": (0.35, 0.7), "mass": (1.5, 3.0), "light": (0.4, 1.0), "gear_rail": (8.0, 14.0),
         **_of_joint("rail", (1.5, 4.0), (0.8, 2.5))},
    ),
    "leg": Robot(
        LEG, ("hip", "knee"), {"hip": 0.6, "knee": 0.05},
        {"length": (0.25, 0.4), "mass": (1.0, 2.0), "light": (0.3, 0.6), "gear_hip": (8.0, 14.0),
         "kp_knee": (300.0, 600.0), **_of_joint("hip", (0.2, 0.6), (0.2, 0.6)),
         **_of_joint("knee", (5.0, 12.0), (1.0, 4.0))},
    ),
}  # fmt: skip
HIDDEN = ("nothing", "friction", "damping", "drive", "delay")
FACTORS = {"friction": (2.0, 4.0), "damping": (2.0, 4.0), "drive": (0.55, 0.8)}
DELAY = (0.012, 0.03)  # [s]
# By which a value of a unit differs from its file; others by OTHER. Lengths of links are known from drawings.
SPREAD = {"damping": 0.03, "friction": 0.03, "length": 0.0}
OTHER = 0.01
NOISE = {"rad": (3e-4, 1.5e-3), "m": (5e-5, 3e-4)}
RATE, SECONDS = 100, 25.0
ANSWER = ("verdict", "right", "named", "members", "value", "low", "high", "told", "chi2")
COLUMNS = (
    "robot", "hidden", "joint", "truth", "noise_rad", "noise_m", *ANSWER, "seconds", "commit",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One unit: a robot, its values, and what it hides.

    Attributes:
        robot: One of `ROBOTS`.
        hidden: One of `HIDDEN`.
        joint: Joint at which it is hidden; empty for nothing and for a delay of all commands.
        truth: Value of the unit that is hidden, or its delay [s].
        given, unit: Values of the file and of the unit.
        noise: Of angles [rad] and of places [m].
        seed: Of motion and noise.
    """

    robot: str
    hidden: str
    joint: str
    truth: float
    given: dict[str, float]
    unit: dict[str, float]
    noise: dict[str, float]
    seed: int


def draw_case(seed: int, index: int) -> Case:
    """Return a case, which follows from seed and number alone."""
    rng = np.random.default_rng([seed, index])
    name = list(ROBOTS)[index % len(ROBOTS)]
    hidden = HIDDEN[(index // len(ROBOTS)) % len(HIDDEN)]
    robot = ROBOTS[name]
    given = {k: float(f"{rng.uniform(*span):.3g}") for k, span in robot.usual.items()}
    spread = {k: SPREAD.get(k.split("_")[0], OTHER) for k in given}
    unit = {k: v * (1.0 + spread[k] * float(rng.standard_normal())) for k, v in given.items()}
    joint, truth = "", 0.0
    if hidden == "delay":
        truth = float(rng.uniform(*DELAY))
    elif hidden != "nothing":
        kinds = ("gear", "kp") if hidden == "drive" else (hidden,)
        value = str(rng.choice([k for k in given if k.split("_")[0] in kinds]))
        joint = value.split("_")[1]
        unit[value] *= float(rng.uniform(*FACTORS[hidden]))
        truth = unit[value]
    noise = {k: float(np.exp(rng.uniform(*np.log(span)))) for k, span in NOISE.items()}
    return Case(name, hidden, joint, truth, given, unit, noise, int(rng.integers(2**31)))


def write_log(case: Case, folder: Path) -> tuple[Path, Path]:
    """Simulate the unit with MuJoCo's own steps, and write the robot's file and the log as a user has them."""
    robot, rng, mujoco = ROBOTS[case.robot], np.random.default_rng(case.seed), mujoco_library()
    model = mujoco.MjModel.from_xml_string(robot.text.format(**case.unit))
    data, step = mujoco.MjData(model), model.opt.timestep
    per, count = round(1.0 / (RATE * step)), round(SECONDS * RATE)
    t = np.arange(count) / RATE
    command = np.zeros((count, len(robot.driven)))
    for k, most in enumerate(robot.driven.values()):
        for _ in range(5):
            command[:, k] += (
                most / 2.5 * np.sin(2 * np.pi * rng.uniform(0.08, 0.8) * t + rng.uniform(0, 2 * np.pi))
            )
    if rng.uniform() < 0.3:
        held = RATE * 3 // 2
        command = np.repeat(command[::held], held, axis=0)[:count]  # goals that jump
    late = round(case.truth / step) if case.hidden == "delay" else 0
    sent = np.repeat(command, per, axis=0)
    sent = np.vstack([np.repeat(sent[:1], late, axis=0), sent])
    shown = np.zeros((count, model.nq))
    for k in range(count):
        shown[k] = data.qpos
        for i in range(per):
            data.ctrl[:] = sent[k * per + i]
            mujoco.mj_step(model, data)
    units = ["m" if j in SLIDES else "rad" for j in robot.joints]
    shown += np.array([case.noise[u] for u in units]) * rng.standard_normal(shown.shape)
    xml, log = folder / f"{case.robot}.xml", folder / "log.csv"
    xml.write_text(robot.text.format(**case.given))
    # A goal has the unit of its joint, a motor with a gear has none.
    goals = {f"s_{j}": f"_{u}" for j, u in zip(robot.joints, units, strict=True)}
    commands = [
        f"{name}_cmd{goals.get(name, '')}" for name in (model.actuator(i).name for i in range(model.nu))
    ]
    header = [
        "time_s",
        *(f"{j}_pos_{u}" for j, u in zip(robot.joints, units, strict=True)),
        *commands,
    ]
    rows = np.column_stack([t, shown, command])
    np.savetxt(log, rows, fmt="%.6f", delimiter=",", header=",".join(header), comments="")
    return log, xml


def wanted(case: Case) -> set[str]:
    """Names of causes of which each says what is hidden: the parameter, and effects that act in the same way."""
    joint, one = case.joint, len(ROBOTS[case.robot].driven) == 1
    actuator = {"shoulder": "m_shoulder", "elbow": "m_elbow", "pan": "s_pan", "tilt": "s_tilt", "rail": "drive",
                "hip": "m_hip", "knee": "s_knee"}.get(joint, "")  # fmt: skip
    return {
        "nothing": set(),
        "friction": {f"changed(frictionloss({joint}))", f"coulomb({joint})"},
        "damping": {f"changed(damping({joint}))", f"viscous({joint})"},
        "drive": {f"changed(gain({actuator}))", f"changed(kp({actuator}))", f"gain({joint})"},
        "delay": {"actuation_delay(all)", "sensing_delay"} | ({"actuation_delay"} if one else set()),
    }[case.hidden]


def is_right(case: Case, found: Diagnosis) -> bool:
    """Whether the only cause has what is hidden in its class; of a healthy unit, whether nothing is named."""
    if case.hidden == "nothing":
        return found.verdict == "nothing"
    return names_only(found, wanted(case))


def names_only(found: Diagnosis, names: set[str]) -> bool:
    """Whether the only cause has one of these names in its class."""
    members = set(found.causes[0].members) | {found.causes[0].name} if found.causes else set()
    # A robot of one command has no place in the name of what acts on it.
    names = names | {name.split("(")[0] for name in names if not name.startswith("changed")}
    return len(found.causes) == 1 and bool(members & names)


def answer_of(found: Diagnosis, right: bool) -> dict[str, str | float]:
    """Return the columns `ANSWER` of a row."""
    first = next(iter(found.causes[0].parameters.values()), None) if found.causes else None
    return {
        "verdict": found.verdict, "right": int(right), "named": " + ".join(c.name for c in found.causes),
        "members": " ".join(found.causes[0].members) if found.causes else "",
        "value": "" if first is None else f"{first.value:.4g}", "low": "" if first is None else f"{first.low:.4g}",
        "high": "" if first is None else f"{first.high:.4g}",
        "told": "; ".join(f"{m.name} {m.estimate.value:.4g}" for m in found.moved), "chi2": f"{found.chi2_after:.3f}",
    }  # fmt: skip


def row_of(case: Case, found: Diagnosis, seconds: float) -> dict[str, str | float]:
    """Return the row of a case."""
    return {
        "robot": case.robot, "hidden": case.hidden, "joint": case.joint, "truth": f"{case.truth:.4g}",
        "noise_rad": f"{case.noise['rad']:.2g}", "noise_m": f"{case.noise['m']:.2g}",
        **answer_of(found, is_right(case, found)),
        "seconds": f"{seconds:.0f}", "commit": provenance()["commit"],
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)

    def answered(index: int) -> dict[str, str | float]:
        case, folder = draw_case(args.seed, index), args.out / f"{args.seed}_{index}"
        folder.mkdir(parents=True, exist_ok=True)
        log, xml = write_log(case, folder)
        began = time.process_time()
        found = diagnose(log, load_system(xml))
        return row_of(case, found, time.process_time() - began)

    go_on(args.out / f"cases_{args.seed}.csv", COLUMNS, args.cases, answered)
    return 0


if __name__ == "__main__":
    sys.exit(main())

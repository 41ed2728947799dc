"""Study: files of robots as their makers publish them, read and compared with MuJoCo.

python -m experiments.studies.diagnosis.public_robots --robots FOLDER --out OUT [--seed 0] [--motions 3]

Every .urdf and .xml file under the folder that moves is read as ``--system`` reads it. Its accelerations at random
positions and speeds are compared with MuJoCo's for the same file, both without contact, limits and dry friction.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from deepkoco.output.whole_file import whole_file
from deepkoco.systems.loading import SystemLoadError, load_system
from deepkoco.systems.motion import Motion
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.model_file import read_model
from deepkoco.systems.trees.mujoco_library import mujoco_library

COLUMNS: tuple[str, ...] = ("file", "joints", "parameters", "largest_difference", "answer")
MOVES = 0.5  # standard deviation of random positions and speeds [rad, m, rad/s, m/s]
MUJOCO = mujoco_library()
OFF = (
    MUJOCO.mjtDisableBit.mjDSBL_CONTACT
    | MUJOCO.mjtDisableBit.mjDSBL_LIMIT
    | MUJOCO.mjtDisableBit.mjDSBL_FRICTIONLOSS
)
NO_ROBOT = (
    "the model has no joints",
    "Unrecognized XML model type",
)  # scenes, parts, and files of other programs


def difference_from_mujoco(system: TreeSystem, path: Path, rng: np.random.Generator, motions: int) -> float:
    """Return the largest difference of accelerations, as a share of the largest one of the same motion."""
    model, _ = read_model(path, system.held)
    model.opt.disableflags |= int(OFF)
    angles, speeds = (MOVES * rng.standard_normal((motions, model.nv)) for _ in range(2))
    wanted = np.empty((motions, model.nv))
    for k in range(motions):
        data = MUJOCO.MjData(model)
        data.qpos[:], data.qvel[:] = angles[k], speeds[k]
        MUJOCO.mj_forward(model, data)
        wanted[k] = data.qacc
    none = torch.zeros(motions, dtype=torch.float64)
    parameters = {
        name: 0.0 * value if name.startswith("frictionloss(") else value
        for name, value in system.default_parameters().items()
    }
    commands = tuple(system.shape_command(k, none, none, parameters) for k in range(len(system.commands)))
    motion = Motion(_columns(angles), _columns(speeds), commands, (none,) * system.joints)
    found = torch.stack(system.accelerations(parameters)(motion), -1).numpy()
    return float((np.abs(found - wanted).max(1) / np.maximum(np.abs(wanted).max(1), 1e-12)).max())


def row_of(path: Path, folder: Path, seed: int, motions: int) -> dict[str, str | int]:
    """Return the row of one file."""
    row: dict[str, str | int] = {"file": path.relative_to(folder).as_posix()}
    try:
        system = load_system(path)
    except SystemLoadError as error:
        return row | {
            "answer": " ".join(str(error).split()).replace(f"{path}: ", "").replace(f"{folder}/", "")
        }
    assert isinstance(system, TreeSystem)
    difference = difference_from_mujoco(system, path, np.random.default_rng(seed), motions)
    return row | {
        "joints": system.joints,
        "parameters": len(system.parameters),
        "largest_difference": f"{difference:.2g}",
        "answer": "; ".join(system.notes),
    }


def files_of(folder: Path) -> list[Path]:
    """Return the files that may describe a robot."""
    found = sorted([*folder.rglob("*.urdf"), *folder.rglob("*.xml")])
    return [path for path in found if _tag(path) in ("robot", "mujoco")]


def _tag(path: Path) -> str:
    try:
        return ElementTree.parse(path).getroot().tag
    except ElementTree.ParseError:
        return ""


def _columns(values: np.ndarray) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(values[:, k].copy()) for k in range(values.shape[1]))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--robots", type=Path, required=True, help="folder with files of robots, at any depth"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for public_robots.csv")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--motions", type=int, default=3, help="random motions of each robot")
    options = parser.parse_args(arguments)
    paths = files_of(options.robots)
    if not paths:
        parser.error(f"--robots {options.robots}: there is no .urdf or .xml file of a robot in it")
    options.out.mkdir(parents=True, exist_ok=True)
    rows = [row_of(path, options.robots, options.seed, options.motions) for path in tqdm(paths, unit="robot")]
    rows = [row for row in rows if not any(text in str(row["answer"]) for text in NO_ROBOT)]
    with whole_file(options.out / "public_robots.csv") as path, path.open("w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    count = Counter("read" if "joints" in row else "refused" for row in rows)
    alike = sum(float(row["largest_difference"]) < 1e-8 for row in rows if "joints" in row)
    sys.stdout.write(
        f"{count['read']} read, {alike} of them as MuJoCo within 1e-8; {count['refused']} refused\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

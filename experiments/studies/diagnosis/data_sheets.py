"""Study: is a parameter called off its data sheet where it is not, and where it is?

python -m experiments.studies.diagnosis.data_sheets --out FILE.csv [--seeds 50000 50001] [--sheets right]

A sheet states a value and a standard deviation of every parameter of a pendulum or of a cart with a pole. MuJoCo moves
the unit, without an equation of the package; its masses, frictions and armature differ by 1 to 3 % from the sheet.
Whether that is a fault is what the sheet says: it is 0.5 to 1.5 deviations of one of 2 %, and up to 3 of one of 1 %.

| sheet | what it states | right answer |
|---|---|---|
| right | 2 % of everything | nothing |
| strict | 1 % of everything | nothing; the unit is at most 3 deviations off |
| one_wrong | 2 %, and one value that is 6 of these deviations away from the sheet of the others | that parameter |
| small_errors | 2 %; the unit has a lag, a bias and a drag of its own, as in HiddenCause | nothing, or what it has |

A study that is started again goes on.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording, Series
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import System, any_system
from experiments.plumbing.provenance import provenance
from experiments.studies.diagnosis.hidden_cause.unit import OFF, Taken, Unit
from tests.oracle.mujoco_robots import Robot, cart_pole, pendulum
from tests.oracle.mujoco_unit import Log, record

COLUMNS: tuple[str, ...] = (
    "sheet", "seed", "robot", "wrong", "verdict", "named", "class", "value", "low", "high", "stated", "sds",
    "chi2_refit", "chi2_final", "cpu_s", "commit",
)  # fmt: skip
SHEETS = {"right": 0.02, "strict": 0.01, "one_wrong": 0.02, "small_errors": 0.02}  # stated share of a value
WRONG_BY = 6.0  # stated standard deviations
LENGTH = (15.0, 20.0)  # of a log [s]
# A log tells of these at once. Of an armature and a damping of a few per cent of the whole, it tells little.
TOLD = {"pendulum": "gain(motor)", "servo_pendulum": "mass(link)", "cart_pole": "mass(cart)"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases; the file is written after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(50000, 50010)))
    parser.add_argument("--sheets", nargs="+", choices=list(SHEETS), default=list(SHEETS))
    args = parser.parse_args(arguments)
    rows = list(csv.reader(args.out.read_text().splitlines())) if args.out.exists() else [list(COLUMNS)]
    if rows[0] != list(COLUMNS):
        parser.error(f"{args.out} is no table of this study; choose another file")
    done, commit = {(r[0], r[1]) for r in rows[1:]}, str(provenance()["commit"])
    for seed in args.seeds:
        for sheet in args.sheets:
            if (sheet, str(seed)) in done:
                continue
            with tempfile.TemporaryDirectory() as folder:
                rows.append([*row(sheet, seed, Path(folder)), commit])
            sys.stdout.write(",".join(rows[-1]) + "\n")
            sys.stdout.flush()
            write_whole_text(args.out, "".join(",".join(r) + "\n" for r in rows))


def row(sheet: str, seed: int, folder: Path) -> list[str]:
    """Diagnose one case; return its row without the commit."""
    rng = np.random.default_rng([seed, 61])
    kind = str(rng.choice(["pendulum", "servo_pendulum", "cart_pole"]))
    drive = "position" if kind == "servo_pendulum" else "motor"
    robot = cart_pole(rng) if kind == "cart_pole" else pendulum(rng, drive)
    seconds = float(rng.uniform(*LENGTH))
    wrong = TOLD[kind] if sheet == "one_wrong" else ""
    system = sheet_of(robot, SHEETS[sheet], wrong, folder)
    if sheet == "small_errors":
        log = Unit(robot, None, seed).recording(Taken(seed, seconds))
    else:
        log = recording_of(record(robot, None, seed, seconds, off=_off))
    began = time.process_time()
    found = diagnose([log], system)
    spent = time.process_time() - began
    told = [""] * 5
    first = found.causes[0] if found.causes else None
    if first is not None and first.name.startswith("changed("):
        parameter = system.parameter(first.name.removeprefix("changed(").removesuffix(")"))
        e = first.parameters[parameter.name]
        away = (e.value - parameter.value) / parameter.prior_sd
        told = [f"{e.value:.5g}", f"{e.low:.5g}", f"{e.high:.5g}", f"{parameter.value:.5g}", f"{away:.2f}"]
    members = (
        "" if first is None else " ".join([*first.members, *(f"changed({m.name})" for m in first.same_as)])
    )
    chi2 = (f"{x:.3f}" for x in (found.chi2_before, found.chi2_after))
    return [
        sheet,
        str(seed),
        kind,
        wrong,
        found.verdict,
        " ".join(found.names),
        members,
        *told,
        *chi2,
        f"{spent:.1f}",
    ]


def sheet_of(robot: Robot, share: float, wrong: str, folder: Path) -> System:
    """Write a model and what its sheet states of every parameter; return it as a system.

    Args:
        robot: The model.
        share: Standard deviation that is stated, as a share of each value; of a value that is 0, this share of a
            tenth of what is guessed without a sheet stands for it.
        wrong: Parameter whose stated value is `WRONG_BY` of these above the model's; empty for none.
        folder: An existing folder.
    """
    path = folder / "robot.xml"
    path.write_text(robot.xml)
    stated: dict[str, dict[str, float]] = {}
    for p in any_system(str(path)).parameters:
        value = p.value * (1.0 + WRONG_BY * share) if p.name == wrong else p.value
        sd = share * abs(value) if p.value else 0.1 * p.prior_sd
        stated[p.name] = {"value": float(value), "prior_sd": float(sd)}
    (folder / "robot.parameters.yaml").write_text(yaml.safe_dump({"parameters": stated}))
    return any_system(str(path))


def recording_of(log: Log) -> Recording:
    """A log of the oracle as a user would bring it."""
    commands = [n for n in log.units if n not in log.names]
    channels = {n: Series(log.t, log.commands[:, k], log.units[n], "command") for k, n in enumerate(commands)}
    for k, n in enumerate(log.names):
        channels[n] = Series(log.t, log.readings[:, k], log.units[n], "measurement")
    return Recording(channels, None, None, {})


def _off(rng: np.random.Generator) -> float:
    return 1.0 + float(rng.uniform(*OFF)) * float(rng.choice([-1.0, 1.0]))


if __name__ == "__main__":
    main()

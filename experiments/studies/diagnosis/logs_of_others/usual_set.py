"""Refit with the usual set of parameters, as other tools identify an arm: what a diagnosis is compared with.

The set is armature, viscous and dry friction and a zero error of the sensor for each joint, and one delay of all
commands. Everything else keeps its value as given. There are no priors, only bounds.

python -m experiments.studies.diagnosis.logs_of_others.usual_set --data DATA/so101 --study so101.yaml \
    --question "twelve seconds of each motion" --answer ANSWERS/so101_twelve_seconds_of_each_motion.json --out OUT

Source of the set: PACE (Bjelonic et al., Towards bridging the gap: systematic sim-to-real transfer for diverse legged
robots, 2025), whose parameters of each joint are these, with one delay.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import re
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose.baseline import baseline_from, catalogue_system, with_gauges_fixed
from deepkoco.diagnose.baseline_refit import FEW_WINDOWS, few_windows
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.gain import held_out_gain
from deepkoco.diagnose.refitted import refit_to_logs
from deepkoco.diagnose.tempered import sizes_of_joints
from deepkoco.diagnose.verdict.findings import estimates
from deepkoco.diagnose.verdict.moved import FAR
from deepkoco.fit.data.windows import Windows, window_length
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.cma import cma_es
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.scale_search import search_scales
from deepkoco.fit.threads import one_thread
from deepkoco.logs.recording import Recording
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import ExtendedSystem, System, any_system
from experiments.studies.diagnosis.yaml_studies import read_study

OF_JOINT = ("armature", "damping", "frictionloss")
OF_BODY = ("mass(", "com_", "inertia_")
DELAY = "actuation_delay(all).delay"
DELAYS = (0.0, 0.05, 0.1)  # at which fits start [s]
SPREAD_OF_SIZE = 0.5  # standard deviation of the logarithm of a size at the start of CMA-ES
GENERATIONS = 200


def usual_names(system: ExtendedSystem) -> list[str]:
    """Return the parameters of the set that a system has."""
    wanted = {f"{kind}({j})" for kind in OF_JOINT for j in system.joint_names}
    wanted |= {f"sensor_bias({j}).angle" for j in system.joint_names} | {DELAY}
    return [p.name for p in system.parameters if p.name in wanted]


def fit_usual_set(system: System, windows: Windows, seed: int) -> tuple[dict[str, float], float]:
    """Fit the usual set to windows; return all parameter values, and chi2 per sample with fitted initial states.

    With a servo that is much too stiff, the slopes lead nowhere. So sizes are searched for at several delays, and
    CMA-ES goes on from the best: as PACE does, but from the values of the coarse search.

    Args:
        system: The robot as given.
        windows: Windows to fit.
        seed: Of CMA-ES.
    """
    extended = catalogue_system(system)
    names = usual_names(extended)
    declared = {p.name: p for p in extended.parameters}
    given = {n: p.value for n, p in declared.items()}
    given |= {n: p.value for n, p in Push.declared(extended, windows).items()}
    some = windows.take(few_windows(windows, FEW_WINDOWS))
    problem, sizes = FitProblem(extended, some), [n for n in names if n.startswith(OF_JOINT)]
    groups = sizes_of_joints(baseline_from(system, windows), sizes)
    starts = [search_scales(problem, groups, {**given, DELAY: delay}, some.state)[0] for delay in DELAYS]
    columns = [problem.names.index(n) for n in names]
    log = np.array([n in sizes and given[n] > 0.0 for n in names])
    # A loss may be 0; its logarithm ends at a thousandth of its value as given.
    low = np.array(
        [
            max(declared[n].low, 1e-3 * given[n]) if own else declared[n].low
            for n, own in zip(names, log, strict=True)
        ]
    )
    high = np.array([declared[n].high for n in names])
    spread = np.where(log, SPREAD_OF_SIZE, [0.2 * declared[n].prior_sd for n in names])

    def cost(points: np.ndarray) -> np.ndarray:
        lanes = np.repeat(np.array([[given[n] for n in problem.names]]), len(points), 0)
        lanes[:, columns] = np.clip(np.where(log, np.exp(np.where(log, points, 0.0)), points), low, high)
        nuisance = problem.nuisances.none()[None].expand(len(points), -1)
        shown = problem.predict(lanes, some.state[None].expand(len(points), -1, -1), nuisance)
        return ((some.value - shown) * problem.weight).square().sum((1, 2, 3)).numpy()

    def coordinates(values: np.ndarray) -> np.ndarray:
        inside = np.clip(values, low, high)
        return np.where(log, np.log(np.where(log, inside, 1.0)), inside)

    points = np.array([coordinates(np.array([start[n] for n in names])) for start in starts])
    first = points[int(np.argmin(cost(points)))]
    found = cma_es(
        cost, first, spread, coordinates(low), coordinates(high), np.random.default_rng(seed),
        generations=GENERATIONS, tolerance=1.0,
    )  # fmt: skip
    best = np.where(log, np.exp(np.where(log, found.best, 0.0)), found.best)
    whole = FitProblem(extended, windows)
    # The search has no fitted initial states, so its best point need not be the best with them.
    tried = [*starts, {**given, **dict(zip(names, best.tolist(), strict=True))}]
    state = windows.state.expand(len(tried), -1, -1)
    left = whole.fit_states_each(tried, state)[1].sum(-1).nan_to_num(float("inf"))
    k = int(left.argmin())
    return tried[k], float(left[k]) / windows.samples


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit the usual set to the training logs of one question, and write a table of the held-out errors by joint."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the logs")
    parser.add_argument("--study", type=Path, required=True, help="as for real_logs")
    parser.add_argument("--question", required=True, help="one with test logs")
    parser.add_argument(
        "--answer", type=Path, required=True, help="what real_logs --answers kept of this question"
    )
    parser.add_argument(
        "--halves", nargs=2, default=(), help="two questions with disjoint logs, which are refitted"
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    study = read_study(args.study, args.data)
    system, question = any_system(study.system), study.questions[args.question]
    train, test = (study.recordings(args.data, pieces) for pieces in (question.train, question.test))
    began = time.process_time()
    with one_thread():
        length = question.window or study.window or window_length(system)
        data = cut_data(train, test, system, length)
        values, left = fit_usual_set(system, data.train, args.seed)
        spent = time.process_time() - began
        assert data.held is not None
        start = baseline_from(system, data.train)
        models = {"baseline": start.values, "refit": values, "extended": values}
        gain = held_out_gain(start.system, data.held, models, 0)
    assert gain is not None
    answer = json.loads(args.answer.read_text())
    args.out.mkdir(parents=True, exist_ok=True)
    rows = by_joint(system, {c.name: c.refit for c in gain.channels}, answer["channels"])
    halves = []
    for name in args.halves:
        halves.append(refit_of(system, study.recordings(args.data, study.questions[name].train), length))
        write_whole_text(
            args.out / f"{re.sub(r'[^a-z]+', '_', name)}.json", json.dumps(halves[-1], indent=1) + "\n"
        )
    for row in rows:
        row["names"] = "; ".join(names_at(system, answer, row["joint"]))
        each = [names_at(system, half, row["joint"]) for half in halves]
        for k, names in enumerate(each):
            row[f"half_{k + 1}"] = "; ".join(names)
        if len(each) == 2:
            row["same"] = int(each[0] == each[1])
            row["same_first"] = int(each[0][:1] == each[1][:1])
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole_text(args.out / "joints.csv", text.getvalue())
    figures = {
        "cpu_seconds": round(spent, 1),
        "chi2_per_sample": left,
        "seed": args.seed,
        "values": {n: values[n] for n in usual_names(start.system)},
    }
    write_whole_text(args.out / "usual_set.json", json.dumps(figures, indent=1) + "\n")
    sys.stdout.write(text.getvalue())
    return 0


def refit_of(system: System, train: Sequence[Recording], length: float) -> dict[str, Any]:
    """Return the refit that a diagnosis of these logs begins with: figures like those of an answer, without causes.

    Args:
        system: The robot as given.
        train: Logs to fit.
        length: Length of a window [s].
    """
    began = time.process_time()
    with one_thread():
        data = cut_data(train, (), system, length)
        start = with_gauges_fixed(baseline_from(system, data.train), data.train)
        base = refit_to_logs(start, data)
        deflation = dispersion(base.reference, base.train).deflation
        found = estimates(base.problem, base.reference, base.reference.free, deflation, base.start.narrowed)
    return {
        "causes": [],
        "refit": {n: [e.value, e.low, e.high, e.unit] for n, e in found.items()},
        "windows": len(base.train),
        "chi2_per_sample": base.reference.chi2 / base.train.samples,
        "cpu_seconds": round(time.process_time() - began, 1),
    }


def by_joint(
    system: System, usual: Mapping[str, float], channels: Mapping[str, Sequence[Any]]
) -> list[dict[str, Any]]:
    """Return held-out errors of each joint's angle [mrad] or way [mm].

    Args:
        system: The robot.
        usual: Channel -> error of the usual set.
        channels: Channel -> errors as given, refitted and extended, and the unit.
    """
    rows = []
    for j, joint in enumerate(system.joint_names):
        name = next(
            (c.name for c, s in zip(system.measurements, system.measured_states, strict=True) if s == j), ""
        )
        if name in channels:
            given, refit, extended = (1e3 * float(e) for e in channels[name][:3])
            row = {
                "joint": joint,
                "as_given": given,
                "usual_set": 1e3 * usual[name],
                "refit": refit,
                "diagnosed": extended,
            }
            row["share"] = extended / row["usual_set"]
            rows.append({n: v if isinstance(v, str) else f"{v:.3g}" for n, v in row.items()})
    return rows


def names_at(system: System, answer: Mapping[str, Any], joint: str) -> list[str]:
    """Return what an answer names at a joint: causes, then parameters far from their values as given, farthest first.

    A parameter is far if its whole interval is more than two standard deviations of its prior away.

    Args:
        system: The robot.
        answer: Figures of one question.
        joint: The joint.
    """
    index = system.joint_names.index(joint)
    places = {
        joint,
        *(c.name for c, j in zip(system.commands, system.command_joints, strict=False) if j == index),
    }
    causes = [c["name"] for c in answer["causes"] if c["name"].partition("(")[2].rstrip(")") in places]
    far = []
    for name, (_, low, high, _unit) in answer["refit"].items():
        of_body = name.startswith(OF_BODY)  # a body may have the name of a joint
        if name.partition("(")[2].rstrip(")") in places and not of_body and f"changed({name})" not in causes:
            p = system.parameter(name)
            away = max(low - p.value, p.value - high) / p.prior_sd
            if away > FAR:
                far.append((away, name))
    return [*causes, *(name for _, name in sorted(far, reverse=True))]


if __name__ == "__main__":
    raise SystemExit(main())

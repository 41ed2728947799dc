"""Refit with the usual set of parameters, as other tools identify an arm: what a diagnosis is compared with.

The set is armature, viscous and dry friction and a zero error of the sensor for each joint, and one delay of all
commands. Everything else keeps its value as given. The priors are as wide as the bounds allow, so they decide nothing.

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
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose.baseline import FEW_WINDOWS, baseline_from, catalogue_system, few_windows
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.gain import held_out_gain
from deepkoco.diagnose.tempered import sizes_of_joints
from deepkoco.diagnose.verdict.moved import FAR
from deepkoco.fit.data.windows import Windows, window_length
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.residual_noise import with_sharp_noise
from deepkoco.fit.solve.scale_search import search_scales
from deepkoco.fit.threads import one_thread
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import ExtendedSystem, System, any_system
from experiments.studies.diagnosis.yaml_studies import read_study

OF_JOINT = ("armature", "damping", "frictionloss")
OF_BODY = ("mass(", "com_", "inertia_")
DELAY = "actuation_delay(all).delay"
DELAYS = (0.0, 0.05, 0.1)  # at which fits start [s]
WIDE = 100.0  # prior standard deviations of the usual set, in declared ones
SCOUTING, ITERATIONS = 8, 40


def usual_names(system: ExtendedSystem) -> list[str]:
    """Return the parameters of the set that a system has."""
    wanted = {f"{kind}({j})" for kind in OF_JOINT for j in system.joint_names}
    wanted |= {f"sensor_bias({j}).angle" for j in system.joint_names} | {DELAY}
    return [p.name for p in system.parameters if p.name in wanted]


def fit_usual_set(system: System, windows: Windows) -> tuple[dict[str, float], Fit]:
    """Fit the usual set to windows, from several delays; return all parameter values and the best fit.

    Sizes are searched for before slopes are used, as in the refit of a diagnosis.

    Args:
        system: The robot as given.
        windows: Windows to fit.
    """
    extended = catalogue_system(system)
    names = usual_names(extended)
    declared = [replace(p, prior_sd=WIDE * p.prior_sd) for p in extended.parameters if p.name in names]
    prior = Prior.of(declared)
    given = {p.name: p.value for p in extended.parameters}
    given |= {n: p.value for n, p in Push.declared(extended, windows).items()}
    some = windows.take(few_windows(windows, FEW_WINDOWS))
    sizes = sizes_of_joints(baseline_from(system, windows), [n for n in names if n.startswith(OF_JOINT)])
    problem = FitProblem(extended, windows)
    trials = []
    for delay in DELAYS:
        values, _ = search_scales(FitProblem(extended, some), sizes, {**given, DELAY: delay}, some.state)
        for start in (values, {**given, DELAY: delay}):
            state, _ = problem.fit_states(start, windows.state)
            trials.append(Trial("usual set", tuple(names), prior, start, state))
    scouts = problem.fit(trials, SCOUTING)
    best = int(np.argmin([fit.cost for fit in scouts]))
    problem = FitProblem(extended, with_sharp_noise(windows, scouts[best]))
    found = scouts[best]
    last = problem.fit_one(
        replace(trials[best], values=found.values, state=found.state, nuisance=found.nuisance), ITERATIONS
    )
    return last.values, last


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
    parser.add_argument("--halves", type=Path, nargs=2, help="the same of two questions with disjoint logs")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args(arguments)
    study = read_study(args.study, args.data)
    system, question = any_system(study.system), study.questions[args.question]
    train, test = (study.recordings(args.data, pieces) for pieces in (question.train, question.test))
    began = time.process_time()
    with one_thread():
        length = question.window or study.window or window_length(system)
        data = cut_data(train, test, system, length)
        values, fit = fit_usual_set(system, data.train)
        spent = time.process_time() - began
        assert data.held is not None
        start = baseline_from(system, data.train)
        models = {"baseline": start.values, "refit": values, "extended": values}
        gain = held_out_gain(start.system, data.held, models, 0)
    assert gain is not None
    answer = json.loads(args.answer.read_text())
    rows = by_joint(system, {c.name: c.refit for c in gain.channels}, answer["channels"])
    halves = [json.loads(path.read_text()) for path in args.halves or ()]
    for row in rows:
        row["names"] = "; ".join(names_at(system, answer, row["joint"]))
        each = [names_at(system, half, row["joint"]) for half in halves]
        for k, names in enumerate(each):
            row[f"half_{k + 1}"] = "; ".join(names)
        if len(each) == 2:
            row["same"] = int(each[0] == each[1])
            row["same_first"] = int(each[0][:1] == each[1][:1])
    args.out.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole_text(args.out / "joints.csv", text.getvalue())
    figures = {
        "cpu_seconds": round(spent, 1),
        "chi2_per_sample": fit.chi2 / data.train.samples,
        "values": {n: values[n] for n in fit.free},
    }
    write_whole_text(args.out / "usual_set.json", json.dumps(figures, indent=1) + "\n")
    sys.stdout.write(text.getvalue())
    return 0


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

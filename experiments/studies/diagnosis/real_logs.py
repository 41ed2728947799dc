"""Study: diagnose real measured logs and compare held-out errors with the textbook model's.

python -m experiments.studies.diagnosis.real_logs --data FOLDER --log dfki_pendulum --json
python -m experiments.studies.diagnosis.real_logs --data FOLDER --log NEW --train a.csv b.csv:0:4.5 --test c.csv
python -m experiments.studies.diagnosis.real_logs --data FOLDER --log emps --study emps.yaml

With --answers FOLDER the figures of each question are kept there, and what is answered there is not asked again.
A folder that is not known by name is studied as the known one with the same columns; without --train one log in
four is kept for tests.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from deepkoco.diagnose import Diagnosis, diagnose, write_report
from deepkoco.diagnose.progress import Progress, silent
from deepkoco.logs.recording import LogError
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import any_system
from experiments.studies.diagnosis.real_log_studies import FitRequest, Study, parse_piece, study_of
from experiments.studies.diagnosis.yaml_studies import read_study


def answer(folder: Path, study: Study, question: FitRequest, progress: Progress = silent) -> Diagnosis:
    """Diagnose the training stretches; measure on the test logs.

    Raises:
        LogError: A log is missing or cannot be used.
    """
    train, test, healthy = (
        study.recordings(folder, pieces) for pieces in (question.train, question.test, question.healthy)
    )
    window = question.window or study.window
    system = any_system(study.system)
    causes = question.causes(system)
    return diagnose(
        train, system, healthy=healthy, holdout=test, window=window, only=causes, progress=progress
    )


def summary(diagnosis: Diagnosis, seconds: float) -> dict:
    """The figures of one question; the errors without a channel's name are those of the first channel."""
    channels = diagnosis.gain.channels if diagnosis.gain else ()
    first = diagnosis.causes[0] if diagnosis.causes else None
    return {
        "verdict": diagnosis.verdict,
        "first": first.name if first else None,
        "class": list(first.members) if first else [],
        "rmse_baseline": channels[0].baseline if channels else None,
        "rmse_refit": channels[0].refit if channels else None,
        "rmse_extended": channels[0].extended if channels else None,
        "seconds": round(seconds, 2),
        "causes": [
            {
                "name": found.name,
                "class": list(found.members),
                "delta_bic": found.delta_bic,
                "parameters": {n: [p.value, p.low, p.high, p.unit] for n, p in found.parameters.items()},
            }
            for found in diagnosis.causes
        ],
        "channels": {c.name: [c.baseline, c.refit, c.extended, c.unit] for c in channels},
        "windows": diagnosis.windows,
        "window_s": diagnosis.window_s,
        "chi2_per_sample": [diagnosis.chi2_before, diagnosis.chi2_after],
        "refit": {n: [p.value, p.low, p.high, p.unit] for n, p in diagnosis.refit.items()},
        "final": {n: [p.value, p.low, p.high, p.unit] for n, p in diagnosis.final.items()},
        "correlated": diagnosis.correlated,
        "model": {p.name: p.value for p in diagnosis.model.parameters},
        "candidates": [[c.name, c.delta_bic] for c in diagnosis.candidates[:10]],
        "not_identified": diagnosis.unexplained["not_identified"] if diagnosis.unexplained else [],
    }


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Answer the questions of one study and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder that holds one folder per log")
    parser.add_argument("--log", required=True, help="which folder in it, or the path of another")
    parser.add_argument(
        "--study", type=Path, metavar="FILE.yaml", help="a study of your own; see yaml_studies.py"
    )
    parser.add_argument("--question", help="answer only this one of the study's questions")
    parser.add_argument("--train", nargs="+", metavar="FILE[:FROM:TO]", help="logs to explain")
    parser.add_argument(
        "--test", nargs="+", default=[], metavar="FILE[:FROM:TO]", help="logs never fitted, beside --train"
    )
    parser.add_argument("--progress", action="store_true", help="print each step with its processor time")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, help="also write the reports into this new folder")
    parser.add_argument("--answers", type=Path, help="keep the figures of each question in this folder")
    args = parser.parse_args(arguments)
    folder = args.data / args.log
    try:
        if args.study is None:
            study, questions = study_of(folder)
        else:
            study = read_study(args.study, folder)
            questions = dict(study.questions)
        if args.train:
            train, test = (tuple(parse_piece(t) for t in texts) for texts in (args.train, args.test))
            questions = {"given": FitRequest(train, test)}
        if args.question is not None:
            if args.question not in questions:
                raise ValueError(f'--question "{args.question}" is none of: {", ".join(questions)}')
            questions = {args.question: questions[args.question]}
        figures = {}
        for name, question in questions.items():
            kept = args.answers / f"{folder.name}_{_file_name(name)}.json" if args.answers else None
            if kept is not None and kept.exists():
                figures[name] = json.loads(kept.read_text())
                continue
            began, spent = time.perf_counter(), time.process_time()
            diagnosis = answer(folder, study, question, _say if args.progress else silent)
            figures[name] = summary(diagnosis, time.perf_counter() - began)
            figures[name]["cpu_seconds"] = round(time.process_time() - spent, 2)
            # A report that cannot be drawn must not cost the answer.
            if kept is not None:
                _keep(kept, figures[name])
            if args.out:
                write_report(diagnosis, args.out / _file_name(name))
    except (LogError, ValueError) as error:
        sys.stderr.write(f"real_logs: {error}\n")
        return 2
    main_question = next(iter(figures.values()))
    result = {**main_question, "log": args.log, "system": any_system(study.system).name, "questions": figures}
    lines = [json.dumps(result)] if args.json else [_line(name, value) for name, value in figures.items()]
    write("\n".join(lines) + "\n")
    return 0


def _say(step: str) -> None:
    sys.stderr.write(f"{time.process_time():8.1f} s  {step}\n")


def _file_name(question: str) -> str:
    return re.sub(r"\W+", "_", question)


def _keep(path: Path, figures: dict) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole_text(path, json.dumps(figures, indent=1) + "\n")


def _line(name: str, figures: dict) -> str:
    errors = "; ".join(
        f"{channel} {before:.4g} -> refit {refit:.4g} -> {after:.4g} {unit}"
        for channel, (before, refit, after, unit) in figures["channels"].items()
    )
    named = ", ".join(cause["name"] for cause in figures["causes"]) or "no cause"
    return f"{name}: {figures['verdict']} ({named}); {errors}; {figures['seconds']:.0f} s"


if __name__ == "__main__":
    raise SystemExit(main())

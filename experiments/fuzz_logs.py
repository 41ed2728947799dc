"""Study: damaged logs, read, inspected and diagnosed; each must end in one clear error or an honest diagnosis.

python -m experiments.fuzz_logs --cases 1000 --seed 0 --out results/diagnose

A row is kept in ``--rows`` as soon as its case is done: a study that was stopped goes on where it was, with what was
run from the same sources. Many damaged files read back as the same recording (another delimiter, another format,
rows out of order); a recording is diagnosed once, and its verdict stands for all cases that end in it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.diagnose import diagnose
from deepkoco.excitation.record import record
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import NoProposalError, doubts_of, propose, survey_log
from deepkoco.logs.recording import LogError, Recording, read_log
from deepkoco.systems import one_joint
from deepkoco.unit import make_unit
from experiments.log_faults import FAULTS, FORMS, DamagedLog, clean_mapping
from experiments.rows import append_row, origin, read_rows, source_digest

SECONDS = 8.0
LONGEST = 1500  # characters of an error
DIAGNOSING = ("diagnose", "fit", "systems")  # packages of which a verdict depends
NAMING = ("cause", "ambiguous")
# A command in the wrong unit that is named as such is diagnosed, not misdiagnosed.
RESCALED = "command in other unit"
HONEST = {RESCALED: {"unit_slip"}, "wrong sidecar": {"unit_slip"}}
# The clean logs: system and what is hidden in it.
BASES: tuple[tuple[str, dict], ...] = (
    ("rod_pendulum", {}),
    ("rod_pendulum", {"coulomb": {"torque": 0.1}}),
    ("torque_pendulum", {}),
)


@dataclass(frozen=True)
class FuzzCase:
    """One damaged log: which clean log, format, faults, and the seed of their details."""

    base: int
    form: str
    faults: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class FuzzResult:
    """What became of a case.

    Attributes:
        outcome: "refused", "nothing", "cause", "ambiguous", "unknown" or "insufficient".
        names: causes that were named.
        text: the error, or the warnings.
        wrong: what is wrong with it, empty if nothing is.
    """

    outcome: str
    names: tuple[str, ...]
    text: str
    wrong: str


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis of one recording said: its verdict, and each named cause with all it cannot be told from."""

    verdict: str
    named: tuple[tuple[str, tuple[str, ...]], ...]


class Verdicts:
    """Verdicts by content of the recording, kept in a file: the same recording is diagnosed once.

    Stamps are told apart to a microsecond and values to nine digits, so that formats that store them otherwise share.

    Args:
        path: JSON lines; None keeps them in memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.known: dict[str, Verdict] = {}
        for row in read_rows(path):
            self.known[row["key"]] = Verdict(
                row["verdict"], tuple((n, tuple(members)) for n, members in row["named"])
            )

    def of(self, recording: Recording, system: str) -> Verdict:
        """The verdict of a diagnosis with the system's whole catalogue."""
        key = content_key(recording, system)
        if key not in self.known:
            found = diagnose([recording], system)
            self.known[key] = Verdict(found.verdict, tuple((c.name, tuple(c.members)) for c in found.causes))
            append_row(self.path, {"key": key, **asdict(self.known[key])})
        return self.known[key]


def content_key(recording: Recording, system: str) -> str:
    """Digest of all that a verdict depends on: what a diagnosis reads of the recording, and its own sources."""
    digest = hashlib.sha256(f"{system} {source_digest(DIAGNOSING)}".encode())
    start = min(float(series.t[0]) for series in recording.channels.values())
    for name, series in sorted(recording.channels.items()):
        digest.update(f"{name} {series.unit} {series.kind} {len(series)}".encode())
        digest.update(np.round(1e6 * (series.t - start)).astype(np.int64).tobytes())
        digest.update("".join(f"{value:.9g} " for value in series.value.tolist()).encode())
    digest.update(repr([(round(a - start, 6), round(b - start, 6)) for a, b in recording.unknown]).encode())
    return digest.hexdigest()


def clean_frame(base: int) -> pd.DataFrame:
    """The clean log of a base: t [s], torque, theta, omega in the units of the system, one row per measurement."""
    return _clean_log(base).copy()


@cache
def _clean_log(base: int) -> pd.DataFrame:
    name, effects = BASES[base]
    spec = make_unit(name, effects=effects, seed=base)
    log = record(spec, "prbs", SECONDS, control_rate=50.0, clock="simulated", seed=base)
    system = one_joint(name)
    theta, omega, command = (log.channels[n] for n in ("theta", "omega", system.command.name))
    # The command acts from its stamp on; a row holds the one that acts from its time on.
    held = command.hold(theta.t)
    return pd.DataFrame({"t": theta.t, "torque": held, "theta": theta.value, "omega": omega.value})


@cache
def clean_recording(base: int) -> Recording:
    """A clean log, as it is read from CSV."""
    with tempfile.TemporaryDirectory() as folder:
        log = DamagedLog(clean_frame(base), _mapping(base, "csv"), "csv")
        return _read(log.write(Path(folder)), base, None)


def run_case(case: FuzzCase, verdicts: Verdicts) -> FuzzResult:
    """Write, inspect, read and diagnose one damaged log."""
    result, recording, path = read_case(case)
    if recording is None:
        return result
    system = BASES[case.base][0]
    try:
        found, clean = verdicts.of(recording, system), verdicts.of(clean_recording(case.base), system)
    except LogError as error:
        return FuzzResult("refused", (), _said(path, error), _bad_error(path, str(error)))
    except Exception:
        return FuzzResult("traceback", (), "", traceback.format_exc(limit=-4))
    names = tuple(name for name, _ in found.named)
    return FuzzResult(found.verdict, names, result.text, _bad_verdict(case, found, clean))


def read_case(case: FuzzCase) -> tuple[FuzzResult, Recording | None, Path]:
    """Write, inspect and read one damaged log: what became of it so far, and the recording if it was not refused."""
    generator = np.random.default_rng(case.seed)
    log = DamagedLog(clean_frame(case.base), _mapping(case.base, case.form), case.form)
    for fault in case.faults:
        try:
            FAULTS[fault](log, generator)
        except (IndexError, KeyError, ValueError, TypeError):
            break  # two faults may exclude each other: a column that is gone cannot be scaled; the first one stands
    with tempfile.TemporaryDirectory() as folder:
        path = log.write(Path(folder))
        try:
            _inspect(path, BASES[case.base][0])
            recording = _read(path, case.base, log.fill)
        except LogError as error:
            return FuzzResult("refused", (), _said(path, error), _bad_error(path, str(error))), None, path
        except Exception:
            return FuzzResult("traceback", (), "", traceback.format_exc(limit=-4)), None, path
    return FuzzResult("read", (), "; ".join(recording.warnings), ""), recording, path


def _said(path: Path, error: LogError) -> str:
    """What an error says, without the folder that the file lay in for a moment."""
    return str(error).replace(f"{path.parent}/", "")


def cases(number: int, seed: int) -> list[FuzzCase]:
    """Draw different cases with Hypothesis.

    Raises:
        SystemExit: Hypothesis is not installed.
    """
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as seeded

    drawn: dict[FuzzCase, None] = {}

    @seeded(seed)
    @settings(
        max_examples=4 * number,  # it draws some cases again
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),  # pyright: ignore[reportArgumentType]
    )
    @given(case_strategy())
    def draw(case: FuzzCase) -> None:
        if len(drawn) < number:
            drawn[case] = None

    draw()
    return list(drawn)


def case_strategy():
    """Hypothesis strategy of damaged logs: one fault, often a second, in any format."""
    from hypothesis import strategies as st

    names = st.sampled_from(sorted(FAULTS))
    return st.builds(
        FuzzCase,
        base=st.integers(0, len(BASES) - 1),
        form=st.sampled_from(("csv", "csv", *FORMS)),
        faults=st.one_of(st.tuples(names), st.tuples(names), st.tuples(names, names)),
        seed=st.integers(0, 2**31 - 1),
    )


def _mapping(base: int, form: str) -> dict:
    system = one_joint(BASES[base][0])
    return clean_mapping(system.name, system.command.name, system.command.unit, form)


def _read(path: Path, base: int, fill: str | None) -> Recording:
    system = one_joint(BASES[base][0])
    channels = [(c.name, c.unit, c.kind) for c in (system.command, *system.measurements)]
    return read_log(path, system=system.name, channels=channels, fill=fill)


def _inspect(path: Path, system: str) -> None:
    """What `deepkoco inspect` does before it prints; that nothing fits is no mistake."""
    found = survey_log(open_log(path))
    try:
        proposal = propose(found, system).proposal
    except NoProposalError:
        proposal = None
    doubts_of(found, proposal)


def _bad_error(path: Path, text: str) -> str:
    if path.stem not in text:
        return "the error does not name the file"
    if len(text) > LONGEST:
        return f"the error has {len(text)} characters"
    return "the error speaks of a traceback" if "Traceback" in text else ""


def _bad_verdict(case: FuzzCase, found: Verdict, clean: Verdict) -> str:
    if found.verdict not in NAMING:
        return ""
    known = {name for fault in case.faults for name in HONEST.get(fault, ())}
    if clean.verdict in NAMING:
        known |= {member for name, members in clean.named for member in (name, *members)}
    if case.faults.count(RESCALED) > 1:
        known |= {"gain"}  # two slips at once make a factor that is no constant between units
    named = {name for name, members in found.named if not set(members) & known and name not in known}
    return f"names {', '.join(sorted(named))}, which the clean log does not show" if named else ""


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Run the study and print what became of the cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, help="folder that fuzzed_logs.csv and .json are written into")
    parser.add_argument(
        "--rows", type=Path, help="folder in which rows are kept and gone on from; default runs/fuzz_logs"
    )
    args = parser.parse_args(arguments)
    targets = [] if args.out is None else [args.out / f"fuzzed_logs{suffix}" for suffix in (".csv", ".json")]
    for target in targets:
        if target.exists():
            sys.stderr.write(f"fuzz_logs: {target}: exists; move it away\n")
            return 2
    if args.out is not None:
        try:
            args.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            sys.stderr.write(f"fuzz_logs: {args.out}: {error.strerror}\n")
            return 2
    folder = args.rows or Path("runs/fuzz_logs")
    rows = run_cases(
        cases(args.cases, args.seed), folder / f"seed_{args.seed}.jsonl", folder / "verdicts.jsonl"
    )
    summary = summarise(rows) | {"seed": args.seed}
    if targets:
        frame = pd.DataFrame(rows).assign(
            faults=[" + ".join(row["faults"]) for row in rows], names=[" ".join(row["names"]) for row in rows]
        )
        frame.to_csv(targets[0], index=False)
        targets[1].write_text(json.dumps(summary, indent=2) + "\n")
    lines = [json.dumps(summary)] if args.json else [f"{name}: {value}" for name, value in summary.items()]
    write("\n".join(lines) + "\n")
    return 1 if summary["wrong"] else 0


def run_cases(asked: Sequence[FuzzCase], path: Path, verdicts: Path) -> list[dict]:
    """Rows of all cases; those that the file holds already are not run again."""
    source = source_digest()
    known = {FuzzCase(**row["case"]): row for row in map(_as_row, read_rows(path)) if row["source"] == source}
    shared, made, rows = Verdicts(verdicts), origin(source), []
    for number, case in enumerate(asked):
        if case not in known:
            began = time.process_time()
            row = {"case": asdict(case), **asdict(run_case(case, shared))}
            row |= {"cpu_s": round(time.process_time() - began, 3)} | made
            append_row(path, row)
            known[case] = _as_row(row)
        row = known[case]
        if row["wrong"]:
            sys.stderr.write(f"case {number} {case}: {row['outcome']}: {row['wrong']}\n")
        rows.append({**row, **row["case"], "case": number})
    return rows


def _as_row(row: dict) -> dict:
    """A row of the file with what JSON has no tuples for."""
    case = {**row["case"], "faults": tuple(row["case"]["faults"])}
    return {**row, "case": case, "names": tuple(row["names"])}


def summarise(rows: Sequence[dict]) -> dict:
    """Counts of outcomes, of wrong ones by what is wrong, and of cases by fault."""
    wrong = [row for row in rows if row["wrong"]]
    return {
        "cases": len(rows),
        "outcomes": dict(sorted(Counter(row["outcome"] for row in rows).items())),
        "tracebacks": sum(row["outcome"] == "traceback" for row in rows),
        "wrong_causes": sum(row["outcome"] in NAMING for row in wrong),
        "wrong": len(wrong),
        "wrong_by_fault": dict(Counter(fault for row in wrong for fault in row["faults"])),
        "diagnosed_with_warning": sum(row["outcome"] != "refused" and bool(row["text"]) for row in rows),
        "cpu_minutes": round(sum(row["cpu_s"] for row in rows) / 60.0, 1),
        "commits": sorted({row["commit"] for row in rows}),
        "cases_by_fault": dict(sorted(Counter(fault for row in rows for fault in row["faults"]).items())),
    }


if __name__ == "__main__":
    raise SystemExit(main())

"""Study: damaged logs, read, inspected and diagnosed; each must end in one clear error or an honest diagnosis.

python -m experiments.fuzz_logs --cases 1000 --seed 0 --out results/diagnose
"""

from __future__ import annotations

import argparse
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

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.graph.log_files import open_log
from deepkoco.graph.recording import LogError, Recording, read_log
from deepkoco.inspection import NoProposalError, doubts_of, propose, survey_log
from deepkoco.systems import one_joint
from deepkoco.unit import make_unit
from deepkoco.unit.record import record
from experiments.log_faults import FAULTS, FORMS, DamagedLog, clean_mapping

SECONDS = 8.0
LONGEST = 1500  # characters of an error
NAMING = ("cause", "ambiguous")
# A command in the wrong unit that is named as such is diagnosed, not misdiagnosed.
HONEST = {"command in other unit": {"unit_slip"}, "wrong sidecar": {"unit_slip"}}
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
def clean_diagnosis(base: int) -> Diagnosis:
    """The diagnosis of a clean log, as it is read from CSV."""
    with tempfile.TemporaryDirectory() as folder:
        log = DamagedLog(clean_frame(base), _mapping(base, "csv"), "csv")
        return diagnose([_read(log.write(Path(folder)), base, None)], BASES[base][0])


def run_case(case: FuzzCase) -> FuzzResult:
    """Write, inspect, read and diagnose one damaged log."""
    result, recording, path = read_case(case)
    if recording is None:
        return result
    try:
        found = diagnose([recording], BASES[case.base][0])
    except LogError as error:
        return FuzzResult("refused", (), str(error), _bad_error(path, str(error)))
    except Exception:
        return FuzzResult("traceback", (), "", traceback.format_exc(limit=-4))
    return FuzzResult(found.verdict, tuple(found.names), result.text, _bad_verdict(case, found))


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
            return FuzzResult("refused", (), str(error), _bad_error(path, str(error))), None, path
        except Exception:
            return FuzzResult("traceback", (), "", traceback.format_exc(limit=-4)), None, path
    return FuzzResult("read", (), "; ".join(recording.warnings), ""), recording, path


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


def _bad_verdict(case: FuzzCase, found: Diagnosis) -> str:
    if found.verdict not in NAMING:
        return ""
    clean = clean_diagnosis(case.base)
    known = {name for fault in case.faults for name in HONEST.get(fault, ())}
    if clean.verdict in NAMING:
        known |= {member for cause in clean.causes for member in (cause.name, *cause.members)}
    named = {
        cause.name for cause in found.causes if not set(cause.members) & known and cause.name not in known
    }
    return f"names {', '.join(sorted(named))}, which the clean log does not show" if named else ""


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Run the study and print what became of the cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--out", type=Path, help="existing folder; fuzzed_logs.csv and .json are written into it"
    )
    args = parser.parse_args(arguments)
    targets = [] if args.out is None else [args.out / f"fuzzed_logs{suffix}" for suffix in (".csv", ".json")]
    for target in targets:
        if target.exists():
            sys.stderr.write(f"fuzz_logs: {target}: exists; move it away\n")
            return 2
    began, rows = time.perf_counter(), []
    for number, case in enumerate(cases(args.cases, args.seed)):
        result = run_case(case)
        rows.append({"case": number, **asdict(case), **asdict(result)})
        if result.wrong:
            sys.stderr.write(f"case {number} {case}: {result.outcome}: {result.wrong}\n")
    summary = summarise(rows) | {"seed": args.seed, "seconds": round(time.perf_counter() - began, 1)}
    if targets:
        frame = pd.DataFrame(rows).assign(
            faults=[" + ".join(row["faults"]) for row in rows], names=[" ".join(row["names"]) for row in rows]
        )
        frame.to_csv(targets[0], index=False)
        targets[1].write_text(json.dumps(summary, indent=2) + "\n")
    lines = [json.dumps(summary)] if args.json else [f"{name}: {value}" for name, value in summary.items()]
    write("\n".join(lines) + "\n")
    return 1 if summary["wrong"] else 0


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
        "cases_by_fault": dict(sorted(Counter(fault for row in rows for fault in row["faults"]).items())),
    }


if __name__ == "__main__":
    raise SystemExit(main())

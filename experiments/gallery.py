"""Reports of real and hidden cases, as a user gets them: `python -m experiments.gallery --data DATA`.

Each case gets a folder with the page, the terminal's output, the numbers and the extended simulator. A case whose
folder is there already is left as it is; remove it to make it anew.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from deepkoco.diagnose import Diagnosis, diagnose, write_report
from deepkoco.diagnose.report.text import terminal_table
from deepkoco.logs.recording import LogError
from deepkoco.output.new_folder import new_folder
from experiments.provenance import as_markdown
from experiments.real_log_studies import study_of
from experiments.real_logs import answer
from tests.oracle.unit import Hidden, hidden_log

OUT = Path("results/diagnose/gallery")
WIDTH = 110  # of the terminal [characters]
SECONDS = 30.0  # of a hidden case's log


@dataclass(frozen=True)
class Exhibit:
    """One case of the gallery.

    Attributes:
        name: Of its folder.
        about: What is looked at, in a sentence.
        truth: What is known about it.
        diagnose: From the folder of the real logs to the diagnosis.
        real: Whether it needs those logs.
    """

    name: str
    about: str
    truth: str
    diagnose: Callable[[Path], Diagnosis]
    real: bool = False


def _real(log: str, question: str) -> Callable[[Path], Diagnosis]:
    def run(data: Path) -> Diagnosis:
        study, questions = study_of(data / log)
        return answer(data / log, study, questions[question])

    return run


def _hidden(system: str, hidden: Hidden, excitation: str, seed: int) -> Callable[[Path], Diagnosis]:
    def run(_: Path) -> Diagnosis:
        return diagnose([hidden_log(system, hidden, excitation, seed, SECONDS)], system)

    return run


EXHIBITS = (
    Exhibit(
        "real_pendulum",
        "A torque-driven pendulum of DFKI's Underactuated Lab; two controllers fitted, two others tested.",
        "Its makers identified dry friction.",
        _real("dfki_pendulum", "held-out controllers"),
        True,
    ),
    Exhibit(
        "real_servo_payload",
        "A pendulum behind a servo (Go1 actuator); the baseline knows every mass, then a log with 1 kg is called 0 kg.",
        "1 kg hangs at the tip.",
        _real("go1_pendulum", "told 0 kg, given 1 kg"),
        True,
    ),
    Exhibit(
        "real_furuta",
        "A rotary inverted pendulum (Quanser Qube) balanced by a controller; four episodes fitted, two tested.",
        "About 2.3 ms of delay; every episode has encoder zeros of its own.",
        _real("qube_furuta", "held-out episodes"),
        True,
    ),
    Exhibit(
        "hidden_delay",
        "A simulated rod under closed-loop control, by another integrator than the simulator's.",
        "20 ms of actuation delay, and all parameters a little off.",
        _hidden("rod_pendulum", {"actuation_delay": {"delay": 0.02}}, "closed-loop", 41),
    ),
    Exhibit(
        "hidden_arm_friction",
        "A simulated two-link arm on a chirp.",
        "Coulomb friction of 0.3 N m in joint 2.",
        _hidden("two_link_arm", {"coulomb(joint 2)": {"torque": 0.3}}, "chirp", 42),
    ),
    Exhibit(
        "hidden_unknown",
        "A simulated rod in turbulent air, which no cause of the catalogue describes.",
        "A random torque; naming a cause would be wrong.",
        _hidden("rod_pendulum", {"turbulence": {"size": 0.3}}, "steps", 43),
    ),
)


def make(exhibit: Exhibit, data: Path, out: Path) -> None:
    """Diagnose one case and leave its folder, whole or not at all.

    Raises:
        LogError: A log is missing or cannot be used.
    """
    diagnosis = exhibit.diagnose(data)
    console = Console(width=WIDTH, record=True, file=io.StringIO())
    console.print(terminal_table(diagnosis))
    with new_folder(out / exhibit.name) as folder:
        report = write_report(diagnosis, folder / "report", shown_as=exhibit.name).parent
        for path in sorted(report.iterdir()):
            if path.suffix != ".png":  # the page holds them
                path.rename(folder / path.name)
            else:
                path.unlink()
        report.rmdir()
        lines = [line.rstrip() for line in console.export_text().splitlines()]
        (folder / "terminal.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (folder / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")


def index(out: Path) -> str:
    """README of the gallery, from the cases that are there."""
    lines = [
        "# What a diagnosis looks like",
        "",
        "```",
        "python -m experiments.gallery --data DATA",
        "```",
        "",
        "`report.html` is the page that `deepkoco diagnose` writes, `terminal.txt` what it prints, `report.json` the",
        "numbers and `model.yaml` the extended simulator. `DATA` holds the real logs, not part of this package.",
        "",
        "| case | what it is | known truth | verdict | named |",
        "|---|---|---|---|---|",
    ]
    for exhibit in EXHIBITS:
        path = out / exhibit.name / "report.json"
        if not path.exists():
            continue
        report = json.loads(path.read_text(encoding="utf-8"))
        named = "; ".join(_named(c) for c in report["causes"] if c["name"] != "unknown") or "nothing"
        cells = (
            f"[{exhibit.name}]({exhibit.name}/report.html)",
            exhibit.about,
            exhibit.truth,
            report["verdict"],
            named,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _named(cause: dict) -> str:
    values = ", ".join(
        f"{e['value']:.3g} {e['unit']}".removesuffix(" 1") for e in cause["parameters"].values()
    )
    return f"{cause['name']} ({values})" if values else cause["name"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder that holds one folder per real log")
    names = [exhibit.name for exhibit in EXHIBITS]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="cases; default: all")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder of the gallery (default {OUT})")
    args = parser.parse_args(arguments)
    status = 0
    args.out.mkdir(parents=True, exist_ok=True)
    for exhibit in EXHIBITS:
        if exhibit.name not in args.only:
            continue
        if (args.out / exhibit.name).exists():
            print(f"{exhibit.name}: there already")
            continue
        if exhibit.real and args.data is None:
            print(f"error: {exhibit.name}: needs real logs; give --data", file=sys.stderr)
            status = 2
            continue
        try:
            make(exhibit, args.data or Path(), args.out)
            print(f"{exhibit.name}: {args.out / exhibit.name / 'report.html'}", flush=True)
        except (LogError, KeyError) as error:
            print(f"error: {exhibit.name}: {error}", file=sys.stderr)
            status = 2
    (args.out / "README.md").write_text(index(args.out), encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())

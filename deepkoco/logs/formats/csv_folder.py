"""Read a folder with the commands in one CSV and the measurements in another, each with its own clock.

SAGE writes `control.csv` and `state_motor.csv` with lists in the cells, and the names of the joints in
`joint_list.txt`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from deepkoco.logs.formats.csv_file import read_csv
from deepkoco.logs.formats.log_file import LogError, LogFile, Table

COMMANDS = (
    "command",
    "commands",
    "control",
    "controls",
    "action",
    "actions",
    "goal",
    "goals",
    "cmd",
    "target",
    "targets",
)
STATES = (
    "state", "states", "state_motor", "measurement", "measurements", "joint_state", "joint_states", "sensor", "sensors",
    "feedback",
)  # fmt: skip
JOINTS = "joint_list.txt"
LARGEST_LIST = 1 << 16  # bytes of the list of joints


def is_pair(folder: Path) -> bool:
    """Whether a folder has a CSV of commands and one of measurements."""
    stems = [file.stem.lower() for file in _files(folder)]
    return sum(stem in COMMANDS for stem in stems) == 1 and any(stem in STATES for stem in stems)


def read_pair(folder: Path) -> LogFile:
    """Read the files of a folder as topics, named after the files without their suffix.

    Raises:
        LogError: a file of commands or measurements cannot be read.
    """
    names = _joints(folder / JOINTS)
    tables: dict[str, Table] = {}
    skipped: dict[str, str] = {}
    for file in _files(folder):
        try:
            tables[file.stem] = replace(read_csv(file, names).tables[""], kind="CSV", path=file)
        except LogError as error:
            if file.stem.lower() in (*COMMANDS, *STATES):
                raise
            skipped[file.stem] = str(error)
    return LogFile(folder, "folder of CSV", tables, skipped, row_name="row")


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() == ".csv" and file.is_file())


def _joints(path: Path) -> tuple[str, ...]:
    if not path.is_file() or path.stat().st_size > LARGEST_LIST:
        return ()
    try:
        lines = path.read_text(encoding="utf-8").replace(",", "\n").splitlines()
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: the file is not UTF-8; write one name of a joint in each line") from error
    return tuple(line.strip() for line in lines if line.strip())

"""The study of robots that new users describe: its cases, its logs, and how an answer is judged."""

import pytest

from deepkoco.systems import load_system
from experiments.studies.diagnosis.new_users.__main__ import ALL, ROBOTS, ROBOTS_OF, judged
from experiments.studies.diagnosis.new_users.cases import CASES, Case
from experiments.studies.diagnosis.new_users.machines import MACHINES
from experiments.studies.diagnosis.new_users.workshop import WORKSHOP, write_workshop_case


def test_every_case_has_a_name_of_its_own_and_a_description():
    assert len(ALL) == len(CASES) + len(WORKSHOP) + len(MACHINES)
    assert all((ROBOTS / robot.system).is_file() for robot in ROBOTS_OF.values())


@pytest.mark.parametrize("system", sorted({robot.system for robot in ROBOTS_OF.values()}))
def test_descriptions_declare_what_the_units_have(system):
    assert load_system(ROBOTS / system).parameters


def test_logs_follow_from_the_seed(tmp_path):
    folders = [tmp_path / name for name in ("a", "b", "c")]
    for folder, seed in zip(folders, (1, 1, 2), strict=True):
        folder.mkdir()
        write_workshop_case("linkage_dry", folder, seed)
    first, again, other = ((folder / "log.csv").read_text() for folder in folders)
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    ("right", "verdict", "names", "expected"),
    [
        (("coulomb",), "cause", ["coulomb(arm)"], 1),
        (("coulomb",), "cause", ["coulomb(arm)", "lag"], 0),
        (("coulomb",), "nothing", [], 0),
        ((), "nothing", [], 1),
        ((), "cause", ["lag"], 0),
        (("unknown",), "unknown", ["unknown"], 1),
    ],
)
def test_an_answer_is_right_if_it_names_what_is_hidden_and_nothing_else(right, verdict, names, expected):
    causes = [{"name": name, "class": [name], "parameters": {}} for name in names]
    assert judged(Case("robot", right=right), {"verdict": verdict, "causes": causes})["right"] == expected

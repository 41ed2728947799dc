"""The study of designed experiments: logs of their own, and going on after a kill."""

import json
from itertools import islice

import numpy as np
import pytest

from experiments import design_study
from experiments.design_study import all_cases, main, run_cases
from experiments.rows import read_rows
from tests.oracle.excitations import Drive
from tests.oracle.unit import HiddenUnit, hidden_log

SAID = {"class": ["gain"], "alone": True, "right": True, "in_class": True}


@pytest.fixture
def ran(monkeypatch):
    """Names of the cases that were really run; a diagnosis would take minutes."""
    names = []

    def run(case):
        names.append(case.name)
        return {"name": case.name, "seed": case.seed, "ambiguous": False, "usual": SAID}

    monkeypatch.setattr(design_study, "run", run)
    return names


def test_a_study_goes_on_after_a_torn_line(ran, tmp_path):
    path, asked = tmp_path / "rows.jsonl", list(islice(all_cases(10), 3))
    first = run_cases(asked[:2], path)
    with path.open("ab") as file:
        file.write(b'{"name": "rod_pen')
    assert run_cases(asked, path)[:2] == first
    assert ran == [case.name for case in asked]
    assert [row["name"] for row in read_rows(path)] == ran
    assert all(row["commit"] and row["source"] for row in read_rows(path))


def test_rows_of_other_sources_and_seeds_do_not_count(ran, tmp_path, capsys):
    path, asked = tmp_path / "rows.jsonl", list(islice(all_cases(10), 2))
    kept = run_cases(asked, path)
    path.write_text(
        json.dumps(kept[0] | {"source": "older", "ambiguous": True}) + "\n" + json.dumps(kept[1]) + "\n"
    )
    ran.clear()
    main(["--out", str(tmp_path), "--seed", "10", "--cases", "2"])
    assert ran == [asked[0].name]
    assert json.loads(capsys.readouterr().out)["summary"]["left_open_by_the_usual_log"] == 0
    main(["--out", str(tmp_path), "--seed", "50", "--cases", "1"])
    assert json.loads(capsys.readouterr().out)["summary"]["cases"] == 1


def test_length_and_strength_can_be_asked_for(ran, tmp_path, capsys):
    case = next(all_cases(10, 7.0, 0.5))
    assert (case.designed_s, case.strength) == (7.0, 0.5 * next(all_cases(10)).strength)
    main(["--out", str(tmp_path), "--cases", "1"])
    main(["--out", str(tmp_path), "--cases", "1", "--seconds", "7"])
    assert len(ran) == 2  # another length is another case
    capsys.readouterr()
    for wrong in (["--seconds", "1"], ["--strength", "0"], ["--cases", "0"]):
        with pytest.raises(SystemExit):
            main(["--out", str(tmp_path), *wrong])
    assert "--seconds between 5 and 600" in capsys.readouterr().err


def test_a_further_take_is_the_same_unit_with_other_steps_and_other_noise():
    logs = [hidden_log("rod_pendulum", {}, "steps", 7, 2.0, take=take) for take in (0, 1, 1)]
    command, angle = ([log.channels[name].value for log in logs] for name in ("torque", "theta"))
    assert not np.array_equal(command[0], command[1])
    assert np.array_equal(angle[1], angle[2])
    assert HiddenUnit("rod_pendulum", {}, 7).parameters == HiddenUnit("rod_pendulum", {}, 7, 8).parameters
    # Without noise and under the same commands, two takes are one and the same.
    push = Drive([np.pi], [0.0], lambda t, y: [0.5])
    quiet = [hidden_log("rod_pendulum", {}, push, 7, 1.0, noisy=False, take=take) for take in (0, 1)]
    assert np.array_equal(quiet[0].channels["theta"].value, quiet[1].channels["theta"].value)
    loud = [hidden_log("rod_pendulum", {}, push, 7, 1.0, take=take) for take in (0, 1)]
    off = np.stack([log.channels["theta"].value - quiet[0].channels["theta"].value for log in loud])
    assert abs(np.corrcoef(off)[0, 1]) < 0.4

"""Studies of own logs as YAML files: what they ask, what they leave out, and what is refused."""

from pathlib import Path

import pytest

from deepkoco.systems import any_system
from experiments.studies.diagnosis import yaml_studies
from experiments.studies.diagnosis.yaml_studies import StudyFileError, read_study

EMPS = Path(yaml_studies.__file__).parent / "logs_of_others" / "emps.yaml"
STUDY = """
system: rod_pendulum
sidecar:
  time: {column: s, unit: ms}
  channels:
    torque: {column: u, unit: N m, kind: command}
    theta: {column: angle, unit: deg, kind: measurement}
questions:
  held out:
    train: [a.csv, "b.csv:1.5:4"]
    test: [c.csv]
    only: [coulomb, viscous]
    exclude: [viscous]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "study.yaml"
    path.write_text(text)
    return path


def test_study_file_gives_logs_stretches_and_causes(tmp_path):
    study = read_study(written(tmp_path, STUDY))
    question = study.questions["held out"]
    assert [(p.file, p.start) for p in question.train] == [("a.csv", 0.0), ("b.csv", 1.5)]
    assert question.train[1].stop == 4.0
    assert question.causes(any_system(study.system)) == ("coulomb",)


def test_study_reads_logs_by_its_own_sidecar(tmp_path):
    rows = "\n".join(f"{20 * k},{0.1 * (k % 7)},{2.0 * k % 31}" for k in range(60))
    (tmp_path / "a.csv").write_text("s,u,angle\n" + rows + "\n")
    study = read_study(written(tmp_path, STUDY))
    log = study.read(tmp_path, study.questions["held out"].train[0])
    assert log.channels["theta"].t[1] == pytest.approx(0.02)
    assert log.channels["theta"].value[1] == pytest.approx(2.0 * 3.14159265 / 180.0)


def test_emps_study_leaves_every_dry_friction_out_where_it_says_so():
    study = read_study(EMPS)
    names = study.questions["without dry friction"].causes(any_system(study.system))
    assert names is not None
    assert not {"coulomb", "stribeck", "load_friction"} & set(names)
    assert {"torque_bias", "viscous"} <= set(names)
    assert study.questions["what the model lacks"].causes(any_system(study.system)) is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (STUDY.replace("questions", "question"), 'unknown key "question"'),
        (STUDY.replace("train", "learn"), 'held out: unknown key "learn"'),
        (STUDY.replace("system: rod_pendulum", ""), "system is missing"),
        (STUDY.replace("b.csv:1.5:4", "b.csv:4:1.5"), "ends before it begins"),
        ("[]", "gives no keys"),
    ],
)
def test_mistakes_in_a_study_file_are_refused_in_one_sentence(tmp_path, wrong, message):
    with pytest.raises(StudyFileError, match=message):
        read_study(written(tmp_path, wrong))

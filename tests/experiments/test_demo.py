"""The demo's steps that take no minutes: its arguments, its processes and its page."""

import io
import re
import sys
import time
from dataclasses import replace
from datetime import date

import numpy as np
import pytest
from rich.console import Console

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.diagnose.diagnosis import Estimate, Finding
from deepkoco.diagnose.report.folder import write_report
from deepkoco.envs.film import write_clip
from deepkoco.pages.links import relative
from deepkoco.runs.unit_trials import Trial, summarise
from deepkoco.systems import JointSystem, make_system
from experiments.demo.__main__ import main, show_graph
from experiments.demo.page import Outcome, pages_of, terminal_table, write_page
from experiments.demo.training import DemoError, run_side_by_side
from experiments.studies.diagnosis.hidden.recorded import unit_log


@pytest.mark.parametrize("option", [["--unit-episodes", "0"], ["--episodes", "-3"], ["--seed", "-1"]])
def test_bad_arguments_end_with_status_two_before_any_work(option, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--out", str(tmp_path / "demo"), *option])
    assert stop.value.code == 2
    assert option[0] in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


def test_a_failed_training_stops_the_other_one_at_once(tmp_path):
    commands = {
        "baseline": [sys.executable, "-c", "import time; time.sleep(100)"],
        "extended": [sys.executable, "-c", "import sys; print('no such file'); sys.exit(3)"],
    }
    began = time.monotonic()
    with pytest.raises(DemoError, match=r"extended ended with status 3:\nno such file"):
        run_side_by_side(commands, tmp_path, lambda: None, pause=0.05)
    assert time.monotonic() - began < 30.0


def test_trainings_that_succeed_are_waited_for(tmp_path):
    commands = {name: [sys.executable, "-c", f"print('{name}')"] for name in ("one", "two")}
    run_side_by_side(commands, tmp_path, lambda: None, pause=0.05)
    assert (tmp_path / "one.log").read_text() == "one\n"
    assert (tmp_path / "two.log").read_text() == "two\n"


def made_up_diagnosis() -> Diagnosis:
    """A motor offset of 0.5 N m."""
    system = make_system("rod_pendulum")
    assert isinstance(system, JointSystem)
    offset = {"torque_bias.effort": Estimate(0.5, 0.45, 0.55, "N m")}
    cause = Finding("torque_bias", "actuator", ("torque_bias",), 900.0, 1.0, offset)
    return Diagnosis(
        *(
            "cause",
            (cause,),
            (cause,),
            None,
            8.0,
            1.0,
            2.5,
            30,
            1.0,
            (),
            (),
            {},
            {},
            system,
            0,
            {},
            60.0,
            10.0,
        )
    )


def make_outcome(folder, make_run, episodes: int) -> Outcome:
    rng = np.random.default_rng(0)
    (folder / "unit").mkdir(parents=True)
    for name in ("baseline", "extended"):
        make_run(folder / "runs" / name, finished=False)
        frames = [rng.integers(0, 255, (64, 64, 3), dtype=np.uint8) for _ in range(20)]
        write_clip(folder / "unit" / f"{name}.webm", frames, 20.0)
    cost = {"baseline": 250.0, "extended": 150.0}
    trials = [
        Trial(n, e, c + e * (1.0 + c / 100), c < 200.0, 0) for e in range(episodes) for n, c in cost.items()
    ]
    return Outcome(made_up_diagnosis(), trials, summarise(trials), folder, 300.0)


def test_the_page_shows_what_was_found_and_what_it_was_worth(make_run, tmp_path):
    outcome = make_outcome(tmp_path, make_run, 5)
    page = write_page(outcome)
    assert page == tmp_path / "index.html"
    assert not list(tmp_path.glob("*.partial"))
    text = page.read_text(encoding="utf-8")
    assert "http" not in text
    assert "prefers-color-scheme: dark" in text
    assert "among" not in text
    # Means of c + e (1 + c / 100) over e = 0 .. 4: 250 + 2 * 3.5 and 150 + 2 * 2.5; 102 is saved.
    for expected in ("The simulation lacks: torque bias", "0.5 N m", "257 [", "155 [", "saves 102 ["):
        assert expected in text
    assert text.count("data:video/webm;base64,") == 2
    # Stills stand in a grid, so none is cut at an edge, and no text speaks of pictures that are not there.
    assert text.count('<div class="frames">') == 2
    assert "strip" not in text
    # A learning curve that looks worse is of another, harder simulator.
    assert "each cost is of another simulator" in text
    for name in ("cost_on_unit.csv", "cost_on_unit.png", "learning_curves.csv", "learning_curves.png"):
        assert (tmp_path / name).stat().st_size > 0
    screen = io.StringIO()
    Console(file=screen, width=200).print(terminal_table(outcome))
    assert "257 [" in screen.getvalue()
    assert "0.5 [0.45, 0.55] N m" in screen.getvalue()


@pytest.fixture
def diagnosed():
    """A real diagnosis of a short log, with all its pictures."""
    log = unit_log("rod_pendulum", {"torque_bias": {"effort": 0.3}}, "steps", 5, 15.0)
    return diagnose([log], "rod_pendulum", only=["torque_bias", "coulomb"])


@pytest.mark.study
def test_the_pages_of_a_demo_lead_to_each_other_and_every_picture_to_its_numbers(
    diagnosed, make_run, tmp_path
):
    outcome = replace(make_outcome(tmp_path, make_run, 3), diagnosis=diagnosed, distractors="copies")
    pages = pages_of(tmp_path)
    write_report(diagnosed, tmp_path / "diagnosis")
    show_graph(tmp_path / "diagnosis" / "model.yaml", pages["Graph"])
    text = write_page(outcome, date(2026, 3, 4)).read_text(encoding="utf-8")
    for name, page in pages.items():
        if name == "Model":  # was not written
            continue
        content = page.read_text(encoding="utf-8")
        links = re.findall(r'<a (?:download="[^"]*" )?href="([^"#]+)"', content)
        files = [link for link in links if not link.startswith("data:")]
        assert all((page.parent / link).exists() for link in files)
        others = {relative(other, page) for key, other in pages.items() if key not in (name, "Model")}
        assert others <= set(files)
    # Four pictures of the diagnosis and the demo's own two, each for wide windows and for phones.
    assert text.count('viewBox="0 0 648 ') == text.count('viewBox="0 0 295.2 ') == 6
    assert text.count("Numbers: <a href=") == 6
    assert "Do not compare the two panels" in text
    assert "among copies of itself" in text
    assert "Made on 2026-03-04" in text
    assert '<a href="diagnosis/model.yaml">' in text


def test_one_episode_gives_a_page_without_intervals(make_run, tmp_path):
    text = write_page(make_outcome(tmp_path, make_run, 1)).read_text(encoding="utf-8")
    assert "cost 250, upright" in text
    assert "nan" not in text.split("base64,")[0]

"""What the texts say of the thesis, of their own studies and of installing: corrections that must not get lost."""

import csv
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md")])
TEXTS = sorted([*PAGES, *ROOT.glob("results/**/*.md")])


def words(path: str) -> str:
    """The text of a file with every run of white space as one space."""
    return " ".join((ROOT / path).read_text(encoding="utf-8").split())


@pytest.mark.parametrize(
    "path", ["experiments/studies/graph/asynchronous_drift.py", "results/graph/README.md"]
)
def test_the_drift_of_asynchronous_runs_is_figure_2_7a_of_the_thesis(path):
    lines = [
        line for line in (ROOT / path).read_text(encoding="utf-8").splitlines() if "drift" in line.lower()
    ]
    figures = re.findall(r"Fig\. ([\d.]+\w?)", " ".join(lines))
    assert figures == ["2.7a"]


def test_no_text_gives_the_thesis_another_figure_of_the_drift():
    wrong = [
        str(path) for path in TEXTS if re.search(r"Fig(ure|\.) 2\.6\b", path.read_text(encoding="utf-8"))
    ]
    assert not wrong


def test_the_page_on_images_says_that_the_thesis_cites_a_convolutional_network():
    assert "The thesis cites a convolutional network ([132]) and does not list its layers" in words(
        "docs/images.md"
    )


def test_the_page_on_training_says_which_parameters_the_l2_term_covers():
    said = words("docs/training.md")
    assert "It covers all parameters; the thesis excludes biases." in said


def test_the_page_on_distractors_says_that_the_thesis_does_not_drive_its_copies():
    said = words("docs/distractors.md")
    assert "does not say how they are driven" in said


@pytest.mark.parametrize("path", ["docs/comparison.md", "results/README.md", "results/figures/README.md"])
def test_where_baselines_fail_among_copies_both_budgets_are_given(path):
    paragraphs = [
        " ".join(part.split()) for part in re.split(r"\n\s*\n|\n(?=\|)", (ROOT / path).read_text("utf-8"))
    ]
    claims = [text for text in paragraphs if "manipulator" in text and "20,000 steps" in text]
    assert claims
    assert all("140,000" in text for text in claims)


def test_the_page_on_designs_counts_no_cases_by_hand():
    assert "cases so far" not in words("docs/design.md") + words("results/diagnose/README.md")


@pytest.mark.parametrize("path", [*PAGES, *ROOT.glob("docs/*.ipynb")], ids=lambda p: p.name)
def test_no_page_installs_from_an_index_that_has_no_package(path):
    text = path.read_text(encoding="utf-8")
    told = [text[m.start() - 90 : m.end() + 20] for m in re.finditer(r"pip install \"?deepkoco", text)]
    assert all("finds nothing" in said for said in told), told


def test_speeds_of_the_executor_of_gpus_are_those_that_were_measured():
    page = (ROOT / "docs/executors.md").read_text(encoding="utf-8")
    with (ROOT / "results/graph/speed/rollout_h100.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["work"] == "rollout"]
    speed = {(row["executor"], int(row["batch"])): float(row["steps_per_s"]) / 1e6 for row in rows}
    assert f"{speed['cuda', 4096]:.1f} M agent steps per second at 4,096 environments" in page
    assert f"{speed['cuda', 65536]:.0f} M at 65,536" in page
    ratios = [speed["rex", batch] / speed["cuda", batch] for batch in (1024, 4096)]
    assert f"{ratios[0]:.1f} times at 1,024, {ratios[1]:.1f} times at 4,096" in page

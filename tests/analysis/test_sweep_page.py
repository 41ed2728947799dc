"""The page of a sweep: its curves, its table, and a way to every run."""

import re
from datetime import date
from pathlib import Path

import pandas as pd
import pytest

from deepkoco.analysis.page.sweep_page import CURVES, write_sweep_page

GROUPS = {
    "pendulum, distractors none": (150.0, 170.0, 160.0),
    "pendulum, distractors copies": (190.0, 200.0, 250.0),
}


def sweep(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Curves, final rows and table of two groups of three seeds; the first run has a page of its own."""
    rows, table, curves = [], [], []
    for condition, costs in GROUPS.items():
        for seed, cost in enumerate(costs):
            run = folder / "runs" / condition.rpartition(" ")[2] / str(seed)
            run.mkdir(parents=True)
            rows.append((condition, seed, str(run), 400, cost, 90.0 + seed))
        table.append((condition, 3, costs[0], min(costs), max(costs), sum(costs) / 3, min(costs), max(costs)))
        for curve in CURVES:
            curves += [(condition, curve, e, 1000.0 - e, 900.0 - e, 1100.0 - e, 3) for e in (100, 200, 400)]
    (folder / "runs" / "none" / "0" / "analysis.html").write_text("")
    return (
        pd.DataFrame(curves, columns=["condition", "curve", "episodes", "iqm", "low", "high", "seeds"]),
        pd.DataFrame(rows, columns=["condition", "seed", "run", "episodes", "evaluation/cost", "seconds"]),
        pd.DataFrame(table, columns=["condition", "n", "iqm", "low", "high", "mean", "best", "worst"]),
    )


@pytest.fixture
def page(tmp_path) -> Path:
    curves, final, table = sweep(tmp_path)
    (tmp_path / "partial").mkdir()
    written = write_sweep_page(
        tmp_path / "partial", curves, final, table, "first", tmp_path / "summary", date(2026, 3, 4)
    )
    for name, frame in (("curves", curves), ("final", final), ("table", table)):
        frame.to_csv(written.parent / f"{name}.csv", index=False)
    return (tmp_path / "partial").rename(tmp_path / "summary") / written.name


def test_every_link_of_the_page_leads_to_a_file_or_a_run(page):
    links = re.findall(r'<a href="([^"]+)"', page.read_text())
    assert all((page.parent / link).exists() for link in links)
    assert "../runs/none/0/analysis.html" in links
    assert "../runs/copies/2" in links
    assert {"curves.csv", "final.csv", "table.csv"} <= set(links)


def test_the_page_has_every_run_and_every_group_in_its_tables(page):
    text = page.read_text()
    for condition, costs in GROUPS.items():
        for cost in costs:
            assert re.search(
                rf"<td>{condition}</td><td class=\"n\">\d</td><td class=\"n\">{cost:.0f}</td>", text
            )
        assert f'<td class="i">{min(costs):.0f} to {max(costs):.0f}</td>' in text
    assert "deepkoco show " in text
    assert "Made on 2026-03-04" in text


def test_the_page_needs_no_other_file_and_follows_light_dark_and_phones(page):
    text = page.read_text()
    assert "http" not in text
    assert "prefers-color-scheme: dark" in text
    assert text.count('viewBox="0 0 648 ') == text.count('viewBox="0 0 295.2 ') == 2


def test_few_seeds_have_no_interval(page, tmp_path):
    assert page.read_text().count("too few seeds") == len(GROUPS)
    curves, final, table = sweep(tmp_path / "more")
    text = write_sweep_page(tmp_path, curves, final, table.assign(n=10), "first").read_text()
    assert not re.search("few seeds|fewer than", text)
    assert text.count("95 % bootstrap") >= 2


def test_a_single_run_has_a_page(tmp_path):
    curves, final, table = sweep(tmp_path)
    alone = table.iloc[:1].assign(n=1, low=float("nan"), high=float("nan"))
    text = write_sweep_page(tmp_path, curves.iloc[:3], final.iloc[:1], alone, "one").read_text()
    assert "too few seeds" in text
    assert "1 finished run that" in text
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL)

"""The last line of a training of any agent, and where else it is told."""

import json
import re

import pandas as pd
import pytest

from deepkoco.cli.command_line import main

SMALL = {
    "deepkoco": [
        "agent.model.encoder_hidden=[8]", "agent.model.cost_hidden=[8]", "agent.model.pairs=2",
        "agent.first_episodes=4", "agent.first_epochs=2", "agent.iteration_episodes=2", "agent.evaluation_episodes=2",
    ],
    "sac": ["agent.hidden=8", "agent.encoder_hidden=[8]", "agent.random_steps=60", "agent.batch=8"],
}  # fmt: skip


@pytest.mark.parametrize("agent", SMALL)
def test_training_ends_with_a_line_that_evaluate_and_aggregate_tell_again(
    agent, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    task = ["task=pendulum", "+task.kwargs.max_episode_steps=30", "run=runs/one"]
    few = ["agent.total_episodes=6", "agent.final_evaluation_episodes=4", "agent.reference_episodes=3"]
    assert main(["train", *task, *few, f"agent={agent}", *SMALL[agent]]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    pattern = r"runs/one: final cost .* over 3 start states; zero action .*, random episodes .*, EDMDc \+ planner .*: "
    assert re.match(pattern, last)
    assert main(["evaluate", "runs/one", "episodes=2"]) == 0
    said = last.removeprefix("runs/one: ")
    assert capsys.readouterr().out.splitlines()[-1] == f"runs/one: at the end of its training, {said}"
    assert main(["evaluate", "runs/one", "episodes=2", "json=true"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["after_training"] == said
    assert main(["aggregate", "runs", "--out", "summary"]) == 0
    assert pd.read_csv("summary/table.csv")["not_better"][0] in ("0 of 1", "1 of 1")
    told = pd.read_csv("summary/final.csv")["not_better_than"][0]
    assert ("better than each" in said) == (told == "none")

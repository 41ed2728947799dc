"""A log says what the first episodes of a training decided."""

from pathlib import Path

from deepkoco.cli.command_line import main

FEW = [
    "agent.model.encoder_hidden=[8]", "agent.model.cost_hidden=[8]", "agent.model.pairs=2",
    "agent.first_episodes=12", "agent.first_epochs=1", "agent.iteration_episodes=2", "agent.total_episodes=14",
    "agent.evaluation_episodes=2", "agent.final_evaluation_episodes=2", "agent.reference_episodes=0",
    "agent.model.time_step=0.05",
]  # fmt: skip
POLE = ["task=gymnasium", "task.id=falling_pole:FallingPole-v0"]


def test_a_decision_is_one_line_and_none_where_nothing_is_decided(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "agent")
    lines = []
    for name, choice in (
        ("fitted", []),
        ("given", ["agent.fit_horizon=false", "agent.horizon=4", "agent.planner.horizon=3"]),
    ):
        folder = tmp_path / name
        assert main(["train", *POLE, *FEW, *choice, f"run={folder}"]) == 0
        said = capsys.readouterr().out.splitlines()
        lines.append([line for line in said if "the first episodes call for" in line])
        assert not lines[-1] or lines[-1][0].startswith(f"{folder}: the first episodes call for T = ")
    assert [len(found) for found in lines] == [1, 0]

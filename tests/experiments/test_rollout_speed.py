"""The rollout benchmark runs, prints what it measured and writes over nothing."""

import json

import pytest
import torch

from experiments.benchmarks import rollout_speed


def test_speeds_are_printed_and_written(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(rollout_speed, "LEAST_SECONDS", 0.0)
    path = tmp_path / "speed.csv"
    arguments = ["--batch", "1", "--executors", "fused", "--repeats", "1", "--json"]
    assert rollout_speed.main([*arguments, "--out", str(path)]) == 0
    result = json.loads(capsys.readouterr().out)
    (row,) = result["rows"]
    assert (row["work"], row["batch"], row["executor"]) == ("rollout", 1, "fused")
    assert row["steps_per_s"] > 1000
    assert result["bytes_per_environment"]["fused"] < 2000
    assert path.read_text().splitlines()[0].startswith("work,batch,executor,steps_per_s")
    with pytest.raises(SystemExit) as ended:
        rollout_speed.main([*arguments, "--out", str(path)])
    assert ended.value.code == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_cuda_device_its_executor_is_refused_before_anything_runs(capsys):
    with pytest.raises(SystemExit) as ended:
        rollout_speed.main(["--batch", "1", "--executors", "eager", "cuda"])
    assert ended.value.code == 2
    assert "finds no CUDA device; install" in capsys.readouterr().err


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_speeds_of_a_cuda_device_name_it(capsys, monkeypatch):
    monkeypatch.setattr(rollout_speed, "LEAST_SECONDS", 0.0)
    assert rollout_speed.main(["--batch", "64", "--executors", "cuda", "--repeats", "1", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rows"][0]["device"] == result["device"] == torch.cuda.get_device_name()


def test_without_json_a_table_is_printed():
    row = {"work": "rollout", "batch": 64, "executor": "fused"}
    for name, value in (("steps_per_s", 4e6), ("steps_per_cpu_s", 5e6), ("ratio_to_rex_per_cpu_s", 2.5)):
        row |= {name: value, f"{name}_low": 0.9 * value, f"{name}_high": 1.1 * value}
    result = {"rows": [row], "bytes_per_environment": {"fused": 212.5, "own_state": 8.0}}
    header, line, memory = rollout_speed.table(result).splitlines()
    assert header.split()[:3] == ["work", "batch", "executor"]
    assert line.split() == [
        *("rollout", "64", "fused", "4000000", "[3600000,", "4400000]", "5000000", "[4500000,", "5500000]"),
        *("2.50", "x"),
    ]
    assert memory == "memory of an environment: fused 212.5 B, own_state 8 B"


def test_the_peer_is_told_the_same_work():
    work = rollout_speed.description()
    assert [len(weights) for weights, _ in work["layers"]] == [64, 64, 1]
    assert work["parameters"]["mass"] == pytest.approx(0.0509)
    assert len(work["actions"]) == work["population_steps"] == 1050

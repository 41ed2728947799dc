"""The benchmark of gradients: its worlds have the right gradients, and it writes what it measures."""

import csv

import pytest
import torch

from experiments.benchmarks import gradient_speed, gradient_work


@pytest.mark.parametrize("world", gradient_work.WORLDS)
def test_the_gradients_are_those_of_the_eager_executor(world):
    found = [gradient_speed.Ours(world, name, 18, steps=10).with_reset()() for name in ("fused", "eager")]
    for one, other in zip(*found, strict=True):
        scale = float(other.abs().max()) or 1.0
        torch.testing.assert_close(one / scale, other / scale, rtol=0.0, atol=3e-5)


def test_every_work_is_measured_beside_the_rollout(tmp_path, capsys):
    path = tmp_path / "speed.csv"
    gradient_speed.main(
        [
            "--batch",
            "2",
            "--steps",
            "5",
            "--worlds",
            "arm",
            "--repeats",
            "2",
            "--differences",
            "3",
            "--out",
            str(path),
        ]
    )
    with path.open() as file:
        rows = {row["work"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"forward", "gradient", "actions", "reset", "differences_3"}
    assert float(rows["forward"]["ratio_cpu_ms"]) == 1.0
    assert float(rows["gradient"]["kernel_ms"]) > 0.0
    assert "x forward" in capsys.readouterr().out

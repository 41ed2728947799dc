"""The study of real delays: its tests have the size that they claim, and bad folders are refused."""

from pathlib import Path

import numpy as np
import pytest

from deepkoco.graph.delay import Autoregressive, Gaussian
from experiments.studies.graph.real_delays import (
    SETUPS,
    compare,
    correlation_time,
    load,
    main,
    sample_distance,
    significance,
)


@pytest.mark.parametrize("factor", [0.0, 0.5, 0.8])
def test_the_correlation_time_is_that_of_an_autoregression(factor):
    noise = Autoregressive(Gaussian(1.0, 0.1), factor) if factor else Gaussian(1.0, 0.1)
    draws = noise.stream(8, 1.0).draw(np.random.default_rng(0), 4000)
    # 1 + 2 sum a^k = (1 + a) / (1 - a).
    times = [correlation_time(row) for row in draws]
    assert np.mean(times) == pytest.approx((1 + factor) / (1 - factor), rel=0.12)


def test_effective_sizes_keep_the_test_at_its_level_where_full_sizes_do_not():
    law = Autoregressive(Gaussian(1.0, 0.1), 0.8)
    pairs = law.stream(400, 1.0).draw(np.random.default_rng(1), 600).reshape(200, 2, 600)
    honest, naive = [], []
    for first, second in pairs:
        distance = sample_distance(first, second)
        sizes = 600 / correlation_time(first), 600 / correlation_time(second)
        honest.append(significance(distance, *sizes) < 0.05)
        naive.append(significance(distance, 600, 600) < 0.05)
    assert np.mean(honest) < 0.1
    assert np.mean(naive) > 0.25


def test_a_channel_that_drifts_fails_against_model_and_data():
    draws = Gaussian(0.01, 0.001).sample(np.random.default_rng(5), (2000,))
    law = Gaussian(0.01, 0.001)
    same, moved = (
        compare("a", draws[:1000], draws[1000:], law),
        compare("a", draws[:1000], draws[1000:] + 5e-4, law),
    )
    assert same["p_model"] > 0.05 < same["p_halves"]
    assert moved["p_model"] < 0.01 > moved["p_halves"]
    assert moved["p_anderson_darling"] < 0.01


def test_files_name_channels_by_node(tmp_path: Path):
    np.savez(tmp_path / "x.npz", comp__sensor=np.ones(3), comm__state__agent=np.ones(2))
    assert sorted(load(tmp_path / "x.npz", SETUPS["pendulum_real_20hz"])) == ["sensor", "sensor->agent"]


def test_a_folder_without_recordings_is_refused(tmp_path: Path, capsys):
    assert main([str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "there is no pendulum_real_20hz.npz" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

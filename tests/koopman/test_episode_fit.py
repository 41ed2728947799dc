"""EDMDc fitted to recorded episodes: its features and their choice."""

import numpy as np

from deepkoco.koopman.lifting.episode_fit import (
    CENTRES,
    COMPONENTS,
    fit_best_to_episodes,
    scaled_radial_basis,
)


def test_the_unit_of_an_entry_does_not_change_the_features():
    generator = np.random.default_rng(0)
    observations = generator.normal(size=(50, 3))
    scales = np.array([1.0, 1000.0, 0.01])
    one = scaled_radial_basis(observations, 5, np.random.default_rng(1))
    other = scaled_radial_basis(observations * scales, 5, np.random.default_rng(1))
    np.testing.assert_allclose(one(observations), other(observations * scales), rtol=1e-9, atol=1e-12)


def test_many_entries_are_reduced_to_their_leading_components():
    generator = np.random.default_rng(0)
    observations = generator.normal(size=(300, 60)) @ generator.normal(size=(60, 60))
    basis = scaled_radial_basis(observations, 5, generator)
    assert basis.size == COMPONENTS + 5
    assert basis.observation_size == 60
    assert basis(observations).shape == (300, COMPONENTS + 5)


def cart_episodes(generator, spring):
    """Random pushes of a cart, whose wide range needs no functions, or of one on a hardening spring, which does."""
    recorded = []
    for _ in range(12):
        state, rows = generator.uniform(-1, 1, 2), []
        force = 0.0
        for _ in range(60):
            force = float(np.clip(force + generator.normal(), -1, 1))
            rows.append([*state, force])
            speed = state[1] + 0.1 * (force - spring * np.sin(3.0 * state[0]))
            state = np.array([state[0] + 0.1 * speed, speed])
        recorded.append(np.array(rows))
    costs = [np.square(rows[:, :2]).sum(1) + 0.01 * rows[:, 2] ** 2 for rows in recorded]
    return [rows[:, :2] for rows in recorded], [rows[:, 2:] for rows in recorded], costs


def test_functions_are_added_where_they_predict_held_out_costs_better():
    sizes = []
    for spring in (0.0, 4.0):
        generator = np.random.default_rng(1)
        episodes = cart_episodes(generator, spring)
        sizes.append(fit_best_to_episodes(*episodes, 0.1, 0.01, 10, generator).lifting.size)
    assert sizes == [2, 2 + CENTRES]

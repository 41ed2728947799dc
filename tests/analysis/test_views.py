"""Names of inputs, and the plane or the entries that maps are drawn over."""

import gymnasium
import numpy as np

import deepkoco.envs  # noqa: F401 - registers the tasks
from deepkoco.analysis.measures.inputs import describe_inputs
from deepkoco.analysis.measures.points import Points
from deepkoco.analysis.measures.steps import join_steps
from deepkoco.analysis.measures.view import EntriesView, PlaneView, choose_axes, choose_view
from deepkoco.envs.distractors import DistractorOptions, VectorStateDistractors


def pendulum(**kwargs):
    return gymnasium.make_vec(
        "deepkoco/RodPendulum-v0", num_envs=2, vectorization_mode="vector_entry_point", **kwargs
    )


def steps_of(envs):
    observation, _ = envs.reset(seed=1)
    rows = [observation[0]]
    for _ in range(20):
        rows.append(envs.step(envs.action_space.sample() * 0)[0][0])
    rows = np.array(rows, np.float64)
    return join_steps([(rows, np.zeros((len(rows), 1)), np.zeros(len(rows)))])


def test_task_inputs_are_found_among_shuffled_distractors():
    plain, mixed = pendulum(), VectorStateDistractors(pendulum(), "copies", shuffle_seed=3)
    own, _ = plain.reset(seed=5)
    seen, _ = mixed.reset(seed=5)
    inputs = describe_inputs(mixed, 15)
    assert inputs.is_task.sum() == 3
    np.testing.assert_array_equal(seen[:, inputs.place], own)
    assert [inputs.names[i] for i in inputs.place] == ["cos(theta)", "sin(theta)", "omega"]
    assert sorted(n for n, t in zip(inputs.names, inputs.is_task, strict=True) if not t)[0] == "distractor 1"


def test_past_actions_belong_to_the_task():
    inputs = describe_inputs(pendulum(action_history=2), 5)
    assert inputs.names[3:] == ("past action 1", "past action 2")
    assert inputs.is_task.all()


def test_a_projection_mixes_all_inputs():
    envs = VectorStateDistractors(pendulum(), "projection", DistractorOptions(channels=4))
    inputs = describe_inputs(envs, 7)
    assert inputs.is_task is None
    assert isinstance(choose_view(envs, inputs, (0, 1), np.zeros(7)), EntriesView)


def test_the_plane_of_the_pendulum_is_angle_and_speed():
    envs = VectorStateDistractors(pendulum(), "copies", shuffle_seed=3)
    inputs, steps = describe_inputs(envs, 15), steps_of(envs)
    view = choose_view(envs, inputs, (0, 1), steps.observations[0])
    assert isinstance(view, PlaneView)
    assert view.labels == ("theta [rad]", "omega [rad/s]")
    points = view.points(steps, np.random.default_rng(0))
    task = points.observations[:, inputs.place]
    np.testing.assert_allclose(task[:, 0], np.cos(points.x), atol=1e-6)
    np.testing.assert_allclose(task[:, 1], np.sin(points.x), atol=1e-6)
    np.testing.assert_allclose(task[:, 2], points.y, atol=1e-6)
    others = np.delete(points.observations, inputs.place, axis=1)
    assert np.ptp(others, axis=0).max() == 0.0  # held
    assert "12 other inputs" in points.held
    angle, speed = view.coordinates(points.observations)
    np.testing.assert_allclose(speed, points.y, atol=1e-6)
    np.testing.assert_allclose(np.cos(angle), np.cos(points.x), atol=1e-6)
    np.testing.assert_allclose(np.sin(angle), np.sin(points.x), atol=1e-6)


def test_the_plane_of_a_larger_task_is_that_of_the_channels_behind_two_inputs():
    envs = gymnasium.make_vec("deepkoco/Manipulator-v0", num_envs=2, vectorization_mode="vector_entry_point")
    inputs, steps = describe_inputs(envs, 10), steps_of(envs)
    names = list(inputs.names)
    view = choose_view(
        envs, inputs, (names.index("target_x"), names.index("target_y")), steps.observations[0]
    )
    assert [label.split(" ")[0] for label in view.labels] == ["target_x", "target_y"]
    points = view.points(steps, np.random.default_rng(0))
    np.testing.assert_allclose(points.observations[:, names.index("target_x")], points.x, atol=1e-6)
    others = [i for i in range(10) if names[i] not in ("target_x", "target_y")]
    assert np.ptp(points.observations[:, others], axis=0).max() == 0.0
    assert "8 other inputs" in points.held
    # Both inputs are of one angle, so they span no plane.
    assert isinstance(choose_view(envs, inputs, (0, 1), steps.observations[0]), EntriesView)


def test_a_task_of_someone_else_is_drawn_over_two_entries():
    envs = gymnasium.make_vec("Pendulum-v1", num_envs=2, vectorization_mode="sync")
    inputs, steps = describe_inputs(envs, 3), steps_of(envs)
    view = choose_view(envs, inputs, (0, 2), steps.observations[0])
    assert view.labels == ("entry 0", "entry 2")
    points = view.points(steps, np.random.default_rng(0))
    np.testing.assert_array_equal(points.x, points.observations[:, 0])
    np.testing.assert_array_equal(points.y, points.observations[:, 2])


def test_the_axes_are_the_task_inputs_that_the_cost_depends_on_most():
    sensitivity = np.array([0.5, 9.0, 3.0, 1.0])
    assert choose_axes(sensitivity, np.array([True, False, True, True])) == (2, 3)
    assert choose_axes(sensitivity, None) == (1, 2)
    assert choose_axes(np.array([1.0]), None) == (0, 0)


def test_a_grid_is_thinned_on_both_sides():
    x, y = (side.ravel() for side in np.meshgrid(np.arange(10.0), np.arange(6.0)))
    few = Points(np.stack([x, y], -1), x, y, ("x", "y"), (6, 10)).thinned(20)
    assert few.shape == (3, 5)
    assert few.x[:5].tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    np.testing.assert_array_equal(few.observations[:, 1], few.y)

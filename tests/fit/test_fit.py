"""FitProblem, windows and push, on closed-form motion."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from deepkoco.fit import (
    FitProblem,
    Noise,
    Prior,
    Trial,
    cut_windows,
    moving,
    unidentified,
    window_length,
)
from deepkoco.fit.data.halves import halved
from deepkoco.fit.simulate.push import Push
from deepkoco.logs.recording import LogError, Recording, Series
from deepkoco.systems import ExtendedSystem, make_system
from deepkoco.systems.effects import EFFECTS

NOISE = (Noise(0.002, 0.0), Noise(0.05, 0.0))


RATE = math.sqrt(15.0)  # of the rod pendulum's small motion [rad/s]


def free_swing(seconds=8.0, omega=RATE, amplitude=0.02, noise=0.0, rate=100.0) -> Recording:
    """Small motion of the rod pendulum about hanging, in closed form: theta'' = -omega^2 (theta - pi)."""
    t = np.arange(int(seconds * rate)) / rate
    theta = math.pi + amplitude * np.cos(omega * t)
    speed = -amplitude * omega * np.sin(omega * t)
    rng = np.random.default_rng(0)
    theta = theta + noise * rng.standard_normal(len(t))
    return Recording(
        {
            "torque": Series(t[::2], np.zeros(len(t[::2])), "N m", "command"),
            "theta": Series(t, theta, "rad", "measurement"),
            "omega": Series(t, speed, "rad/s", "measurement"),
        },
        system="rod_pendulum",
    )


def problem_of(recording, length=1.0, noise=NOISE) -> tuple[FitProblem, dict[str, float]]:
    base = make_system("rod_pendulum")
    system = ExtendedSystem(base, tuple(EFFECTS))
    windows = cut_windows([recording], base, length, noise)
    values = {p.name: p.value for p in system.parameters}
    values |= {n: p.value for n, p in Push.declared(system, windows).items()}
    return FitProblem(system, windows), values


def test_evaluate_reproduces_a_closed_form_swing():
    problem, values = problem_of(free_swing(amplitude=1e-3))
    fit = problem.evaluate(values)
    # The residual is the difference of sin(x) from x, x^3 / 6 = 2e-10, and the error of the integrator.
    assert fit.chi2 / problem.windows.samples < 1e-9


def test_fit_states_of_all_windows_equal_those_of_single_windows():
    problem, values = problem_of(
        free_swing(amplitude=0.5, noise=0.002), noise=(Noise(0.002, 0.0), Noise(0.05, 0.0))
    )
    start = problem.windows.state.clone()
    start[0] = problem.fit_states(values, start)[0][0]  # settled from the first step on
    start[1] += 0.3
    together, costs = problem.fit_states(values, start)
    for w in range(3):
        alone, cost = problem.of_windows(torch.tensor([w])).fit_states(values, start[w : w + 1])
        torch.testing.assert_close(together[w], alone[0], rtol=0.0, atol=1e-6)
        torch.testing.assert_close(costs[w : w + 1], cost, rtol=1e-6, atol=1e-6)


def test_fit_states_simulates_settled_windows_no_more(monkeypatch):
    problem, values = problem_of(free_swing(amplitude=0.5))
    found, _ = problem.fit_states(values, problem.windows.state)
    start, simulated = found.clone(), []
    start[1] += 1.0
    predict = FitProblem.predict

    def counted(self, theta, initial, nuisance):
        simulated.append(initial.shape[1])
        return predict(self, theta, initial, nuisance)

    monkeypatch.setattr(FitProblem, "predict", counted)
    again, _ = problem.fit_states(values, start)
    torch.testing.assert_close(again, found, rtol=0.0, atol=1e-4)
    assert simulated[0] == len(problem.windows)
    assert simulated[-1] == 1


def test_fit_recovers_gravity_and_reports_mass_as_unidentified():
    # A gravity of 11 makes the swing faster by sqrt(1.1). The mass does not change a free swing.
    problem, values = problem_of(free_swing(omega=math.sqrt(16.5), amplitude=1e-2))
    declared = [problem.system.parameter(n) for n in ("gravity", "mass")]
    prior = Prior.of(declared)
    wide = Prior(prior.names, prior.centre, prior.covariance * 1e4)
    fit = problem.fit([Trial("swing", prior.names, wide, values)])[0]
    assert fit.values["gravity"] == pytest.approx(11.0, rel=2e-4)
    loose = unidentified(fit, wide)
    assert len(loose) == 1
    assert loose[0].weights == pytest.approx({"mass": 1.0})


def test_fit_history_never_increases_and_penalty_is_the_prior():
    problem, values = problem_of(free_swing(omega=math.sqrt(15.3)))
    prior = Prior.of([problem.system.parameter("gravity")])
    fit = problem.fit([Trial("swing", ("gravity",), prior, values)])[0]
    assert all(b <= a for a, b in zip(fit.history, fit.history[1:], strict=False))
    shift = (fit.values["gravity"] - 10.0) / 0.1
    assert fit.penalty == pytest.approx(shift**2, rel=1e-6)
    assert fit.converged


def test_fit_of_a_batch_equals_fits_of_single_trials():
    problem, values = problem_of(free_swing(omega=math.sqrt(15.3)))
    trials = [
        Trial(name, (name,), Prior.of([problem.system.parameter(name)]), values)
        for name in ("gravity", "coulomb.torque", "sensor_bias.angle")
    ]
    together = problem.fit(trials)
    for trial, fit in zip(trials, together, strict=True):
        alone = problem.fit([trial])[0]
        assert fit.values[trial.name] == pytest.approx(alone.values[trial.name], rel=1e-6, abs=1e-9)


def test_predict_ignores_a_saturation_at_its_null_value_in_a_mixed_batch():
    recording = free_swing()
    torque = recording.channels["torque"]
    full = Series(torque.t, np.full(len(torque.t), 2.0), "N m", "command")
    problem, values = problem_of(Recording({**recording.channels, "torque": full}))
    lanes = np.array([[values[n] for n in problem.names]] * 2)
    lanes[0, problem.names.index("torque_bias.effort")] = 0.1
    state, zero = problem.windows.state.repeat(2, 1, 1), torch.zeros(2, 1, dtype=torch.float64)
    alone = problem.predict(lanes[:1], state[:1], zero[:1])
    lanes[1, problem.names.index("saturation.limit")] = 1.5
    assert torch.equal(problem.predict(lanes, state, zero)[0], alone[0])


def test_fit_keeps_parameters_within_bounds():
    problem, values = problem_of(free_swing(omega=math.sqrt(14.0)))
    prior = Prior.of([problem.system.parameter("payload.mass")])
    # The best payload for the slow swing is negative, which the bounds exclude.
    fit = problem.fit([Trial("payload", ("payload.mass",), prior, values)])[0]
    assert fit.values["payload.mass"] >= 0.0


def test_predict_changes_only_windows_with_the_push():
    problem, values = problem_of(free_swing())
    theta = np.array([[values[n] for n in problem.names]])
    pushed = theta.copy()
    at = problem.names.index("event.torque")
    pushed[0, at : at + 4] = [0.5, 2.3, 0.2, 0.0]
    zero = torch.zeros(1, 1, dtype=torch.float64)
    difference = problem.predict(pushed, problem.windows.state[None], zero) - problem.predict(
        theta, problem.windows.state[None], zero
    )
    moved = difference.abs().amax((0, 2, 3))
    touched = (problem.windows.t0 < 2.5) & (problem.windows.t0 + problem.windows.length > 2.3)
    assert (moved[torch.from_numpy(touched)] > 1e-3).all()
    assert (moved[torch.from_numpy(~touched)] == 0.0).all()


def test_halved_keeps_all_samples():
    problem, _ = problem_of(free_swing())
    halves = halved(problem.windows)
    assert halves.samples == problem.windows.samples
    assert halves.t0[::2] == pytest.approx(problem.windows.t0)
    assert float(halves.t.max()) < halves.length


def test_moving_excludes_windows_at_rest():
    recording = free_swing()
    theta = recording.channels["theta"]
    still = np.where(theta.t < 4.0, math.pi, theta.value)
    omega = recording.channels["omega"]
    channels = {
        **recording.channels,
        "theta": Series(theta.t, still, "rad", "measurement"),
        "omega": Series(omega.t, np.where(theta.t < 4.0, 0.0, omega.value), "rad/s", "measurement"),
    }
    windows = cut_windows(
        [Recording(channels)], make_system("rod_pendulum"), 1.0, (Noise(1e-4, 0.0), Noise(1e-3, 0.0))
    )
    assert not moving(windows)[:3].any()
    assert moving(windows)[4:].all()


def test_cut_windows_names_a_missing_command():
    recording = free_swing()
    channels = {n: s for n, s in recording.channels.items() if n != "torque"}
    with pytest.raises(LogError, match='the command "torque" of rod_pendulum is missing'):
        cut_windows([Recording(channels)], make_system("rod_pendulum"), 1.0)


def test_window_length_is_about_one_period():
    assert window_length(make_system("rod_pendulum")) == pytest.approx(
        2 * math.pi / math.sqrt(15.0), rel=1e-3
    )
    assert window_length(make_system("pendulum")) == 1.0


def test_a_fit_of_a_wrong_model_ends_after_as_many_steps_whatever_the_noise_is_said_to_be():
    # Friction that the model lacks leaves a hundred times the noise; with a tenth of the noise said, ten thousand.
    counts = []
    for share in (1.0, 0.1):
        noise = tuple(Noise(share * n.sd, 0.0) for n in NOISE)
        problem, values = problem_of(decaying_swing(), noise=noise)
        declared = [p for p in problem.system.parameters if p.name in ("length", "mass")]
        prior = Prior.of([replace(p, prior_sd=share * p.prior_sd) for p in declared])
        fit = problem.fit([Trial("swing", ("length", "mass"), prior, values)], 40)[0]
        assert fit.converged
        assert fit.chi2 / problem.windows.samples > 20.0
        counts.append(len(fit.history))
    assert counts[0] == counts[1]


def decaying_swing(decay=0.8) -> Recording:
    """A large free swing that decays; its frequency is that of a smaller rod."""
    swing = free_swing(omega=1.1 * RATE, amplitude=0.6)
    t = swing.channels["theta"].t
    faded = np.exp(-decay * t)
    theta = math.pi + 0.6 * faded * np.cos(1.1 * RATE * t)
    speed = np.gradient(theta, t)
    channels = {
        **swing.channels,
        "theta": Series(t, theta, "rad", "measurement"),
        "omega": Series(t, speed, "rad/s", "measurement"),
    }
    return replace(swing, channels=channels)

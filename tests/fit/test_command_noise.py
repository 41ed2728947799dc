"""Commands with noise that no motor felt: whether a log shows it, and residuals without what it does."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import torch

from deepkoco.diagnose.baseline import Near, baseline_from
from deepkoco.diagnose.baseline_refit import refit_sharply
from deepkoco.excitation.record import record
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.wander import Wander, compressed, joined
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.solve import shown_noise
from deepkoco.fit.solve.command_noise import noise_of_commands, with_command_noise
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.residual_noise import with_sharp_noise
from deepkoco.fit.solve.shown_noise import FIRST, Answer, _share_of_directions
from deepkoco.systems import make_system
from deepkoco.unit import make_unit

NOISE = 0.1  # [N m]


@cache
def log(**changed):
    unit = make_unit("torque_pendulum", parameters=changed, sensor={"rate_hz": 200.0}, seed=3)
    return record(unit, "chirp", 20.0, clock="simulated", seed=3)


def measured(recording, sd=NOISE):
    """The log of a driver that measures its torque, with noise."""
    name = recording.names("command")[0]
    torque, rng = recording.channels[name], np.random.default_rng(5)
    noisy = replace(torque, value=torque.value + sd * rng.standard_normal(len(torque)))
    return replace(recording, channels={**recording.channels, name: noisy})


def windows_of(recording):
    windows = cut_windows([recording], make_system("torque_pendulum"), 1.0)
    windows = windows.take(moving(windows))
    return baseline_from(make_system("torque_pendulum"), windows), windows


def asked(recording):
    start, windows = windows_of(recording)
    return with_command_noise(partial(FitProblem, start.system), windows, start.values, windows.state)


def random_wander(seed, windows=3, channels=2, samples=40, pieces=12):
    rng = np.random.default_rng(seed)
    moves = torch.from_numpy(np.cumsum(rng.standard_normal((windows, channels, samples, pieces)), axis=2))
    weight = torch.from_numpy(rng.uniform(0.5, 2.0, (windows, channels, samples)))
    weight[:, :, -3:] = 0.0
    return Wander((1.0,), moves), weight


def test_whitening_is_the_inverse_root_of_the_covariance():
    wander, weight = random_wander(0)
    whitening = wander.whitening(weight)
    moves = (wander.moves * weight[..., None]).flatten(1, 2)
    covariance = torch.eye(moves.shape[1]) + moves @ moves.mT
    unit = torch.eye(80, dtype=torch.float64).reshape(80, 1, 2, 40).expand(-1, 3, -1, -1)
    root = whitening.whitened(unit).flatten(2).permute(1, 0, 2)  # (W, NM, NM)
    torch.testing.assert_close(
        root @ covariance @ root.mT, torch.eye(80, dtype=torch.float64).expand(3, -1, -1)
    )
    torch.testing.assert_close(root, root.mT)
    hidden = whitening.hidden
    torch.testing.assert_close(root @ root, torch.eye(80) - hidden @ hidden.mT)


def test_whitened_residuals_lead_back_to_those_that_were_measured():
    wander, weight = random_wander(1)
    whitening = wander.whitening(weight)
    residual = torch.randn(3, 2, 40, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * (
        weight > 0
    )
    torch.testing.assert_close(whitening.as_measured(whitening.whitened(residual)), residual)
    assert not whitening.whitened(residual)[..., -3:].any()


def test_windows_that_are_taken_and_joined_keep_their_own_noise():
    wander, weight = random_wander(2)
    again = joined(wander.take(torch.tensor([2])), wander.take(torch.tensor([0, 1])))
    residual = weight.sin()
    own = wander.whitening(weight).whitened(residual)
    order = torch.tensor([2, 0, 1])
    torch.testing.assert_close(again.whitening(weight[order]).whitened(residual[order]), own[order])


def test_few_pieces_make_nearly_all_of_the_covariance():
    wander, weight = random_wander(3, pieces=60)
    wander = replace(wander, moves=wander.moves * 0.03 ** (torch.arange(60) / 20.0))
    few, rest = compressed(wander.moves, weight, 0.25, 96)
    whole, told = (
        ((own * weight[..., None]).flatten(1, 2).square().sum((1, 2)) / (weight > 0).flatten(1).sum(1))
        for own in (wander.moves, few)
    )
    assert few.shape[-1] < wander.moves.shape[-1]
    assert float((whole - told).median()) < 0.25
    assert (rest > 0.0).all()


def test_noise_of_a_measured_command_is_found_and_taken_out():
    start, windows = windows_of(measured(log()))
    found, fit = refit_sharply(start, windows)
    assert found.wander is not None
    assert found.wander.sd[0] == pytest.approx(NOISE, rel=0.25)
    plain = with_sharp_noise(replace(found, wander=None), fit)
    exact = FitProblem(start.system, plain).evaluate(fit.values)
    assert exact.chi2 > 5.0 * plain.samples
    assert fit.chi2 < 1.6 * found.samples
    assert abs(dispersion(fit, found).lag_one) < 0.35
    weight = start.values["gravity_torque"]
    assert fit.values["gravity_torque"] == pytest.approx(weight, rel=0.02)


def test_parameters_of_a_log_with_noisy_commands_are_sharper_and_as_honest():
    start, windows = windows_of(measured(log()))
    found, fit = refit_sharply(start, windows)
    problem = FitProblem(start.system, found)
    truth = start.values
    sd = np.sqrt(np.diag(fit.covariance))
    off = [(fit.values[n] - truth[n]) / s for n, s in zip(fit.free, sd, strict=True)]
    assert max(map(abs, off)) < 3.5
    raw = problem.windows.errors(fit.residual)
    torch.testing.assert_close(problem.weighed(raw), fit.residual)


def answer(power, width):
    return Answer(np.asarray(power), np.asarray(width), 0.0, 0.0, 0.0)


@pytest.mark.parametrize("share", [0.3, 1.0, 2.5])
def test_the_share_is_that_by_which_most_directions_are_wide(share):
    rng = np.random.default_rng(7)
    width = 10.0 ** rng.uniform(0.6, 4.0, (40, 12))
    power = (1.0 + share * width) * rng.standard_normal(width.shape) ** 2
    power[:, 0] += 1e7  # a wrong model leaves much more in the widest direction
    found = _share_of_directions([answer(p, w) for p, w in zip(power, width, strict=True)])
    assert found == pytest.approx(share, rel=0.35)


def test_directions_that_only_the_sensors_make_wide_have_no_noise_of_commands():
    rng = np.random.default_rng(8)
    width = 10.0 ** rng.uniform(0.6, 4.0, (40, 12))
    power = rng.standard_normal(width.shape) ** 2
    power[:, :3] += 1e5
    found = _share_of_directions([answer(p, w) for p, w in zip(power, width, strict=True)])
    assert found is not None
    assert found < 0.02


def test_a_few_wide_directions_do_not_tell_the_share():
    narrow = [answer([5.0, 1.0, 1.0], [50.0, 0.1, 0.1]) for _ in range(40)]
    assert _share_of_directions(narrow) is None


@pytest.mark.parametrize("share", [1.0, 0.98, 0.95, 0.9])
def test_noise_that_the_motor_felt_is_none_of_the_log(share):
    # The unit answered every jump of its command; the model may be wrong, too.
    start, windows = windows_of(measured(log()))
    problem_of = partial(FitProblem, start.system)
    problem, values = problem_of(windows), start.values
    theta = np.array([[float(values[n]) for n in problem.names]])
    shown = problem.predict(theta, windows.state[None], problem.nuisances.none()[None])[0]
    rng = torch.Generator().manual_seed(1)
    noise = windows.sample_sd * torch.randn(shown.shape, dtype=torch.float64, generator=rng)
    felt = windows.with_value((shown + noise) * windows.valid)
    given = {**values, "gravity_torque": share * values["gravity_torque"]}
    assert noise_of_commands(felt)[0] > 0.5 * NOISE
    assert with_command_noise(problem_of, felt, given, windows.state).wander is None


@pytest.mark.parametrize("share", [1.0, 0.95, 0.9])
def test_noise_that_no_motor_felt_is_found_beside_a_wrong_model(share):
    start, windows = windows_of(measured(log()))
    given = {**start.values, "gravity_torque": share * start.values["gravity_torque"]}
    found = with_command_noise(partial(FitProblem, start.system), windows, given, windows.state)
    assert found.wander is not None
    assert found.wander.sd[0] == pytest.approx(NOISE, rel=0.3)


def test_commands_without_any_noise_are_not_asked():
    _, windows = windows_of(log())
    still = tuple(replace(c, value=np.zeros_like(c.value)) for c in windows.commands)
    assert noise_of_commands(replace(windows, commands=still)) == (0.0,)


def test_halves_of_windows_have_the_noise_of_their_samples():
    windows = asked(measured(log()))
    halves = halved(windows)
    assert halves.wander is not None
    w = 1
    kept = windows.valid[w, 0] & (windows.t[w, 0] >= 0.5 * windows.length)
    own = halves.valid[2 * w + 1, 0]
    torch.testing.assert_close(halves.wander.moves[2 * w + 1, 0][own], windows.wander.moves[w, 0][kept])


def test_a_refit_begins_with_the_noise_and_the_values_that_are_known():
    start, windows = windows_of(measured(log()))
    found, fit = refit_sharply(start, windows)
    assert found.wander is not None
    known = Near(dict(fit.values), found.wander.take(torch.zeros(0, dtype=torch.long)))
    off = {**start.values, "gravity_torque": 0.6 * start.values["gravity_torque"]}
    again, refitted = refit_sharply(replace(start, values=off, near=known), windows)
    assert again.wander is not None
    assert again.wander.sd == found.wander.sd
    sd = np.sqrt(np.diag(fit.covariance))
    for name, spread in zip(fit.free, sd, strict=True):
        assert refitted.values[name] == pytest.approx(fit.values[name], abs=0.1 * spread)


def test_what_is_near_counts_for_the_free_parameters_alone():
    start, _ = windows_of(log())
    near = replace(start, near=Near({"gravity_torque": 2.0, "lag.time_constant": 0.3}, None)).begun()
    assert near.values["gravity_torque"] == 2.0
    assert near.values["lag.time_constant"] == start.values["lag.time_constant"]


@pytest.mark.parametrize("noisy", [False, True])
def test_a_few_places_tell_that_there_is_no_noise_and_all_of_them_how_much(noisy, monkeypatch):
    counts, usual = [], shown_noise._short_answers

    def answers(*given):
        counts.append(len(given[-1]))
        return usual(*given)

    monkeypatch.setattr(shown_noise, "_short_answers", answers)
    unit = make_unit("torque_pendulum", sensor={"rate_hz": 200.0}, seed=3)
    rough = record(unit, "prbs", 20.0, clock="simulated", seed=3)
    windows = asked(measured(log()) if noisy else rough)
    assert (windows.wander is not None) == noisy
    if noisy:
        assert sum(counts[:2]) > (FIRST - 0.5) * counts[0]
    else:
        assert len(counts) == 1

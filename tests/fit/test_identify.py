"""fit() as users call it, on simulated logs."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from deepkoco.fit import FitError, Identification, Prior, fit
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_model, make_system, save_model
from tests.fit.identify_logs import DELAY, MASS, VISCOUS, pendulum_log, rod_log

ASKED = ("mass", "viscous", "actuation_delay.delay")
TRUE = dict(zip(ASKED, (MASS, VISCOUS, DELAY), strict=True))


@pytest.fixture(scope="module")
def found() -> Identification:
    return fit([pendulum_log()], "pendulum", ASKED)


def test_fit_recovers_parameters_and_delay(found: Identification):
    for name, true in TRUE.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, rel=0.02)
        assert abs(estimate.value - true) < 4.0 * estimate.sd
    assert found.convergence.converged
    assert found.rms["theta"][1] == pytest.approx(0.002, rel=0.1)  # the sensor's noise
    assert found.rms["theta"][0] > 0.01


def test_fit_matches_scipy_least_squares_on_the_same_residuals(found: Identification):
    request = found.request
    problem, count = request.problem(), len(ASKED)
    size = problem.windows.state.numel()
    sd = np.sqrt(np.diag(request.prior.covariance))

    def residuals(x: np.ndarray) -> np.ndarray:
        theta = np.array([[request.start[n] for n in problem.names]])
        theta[0, [problem.names.index(n) for n in ASKED]] = x[:count]
        state = torch.from_numpy(x[count:]).reshape(1, *problem.windows.state.shape)
        predicted = problem.predict(theta, state, torch.zeros(1, 1, dtype=torch.float64))[0]
        data = ((problem.windows.value - predicted) * problem.weight).numpy().ravel()
        return np.concatenate([data, (x[:count] - request.prior.mean(ASKED)) / sd])

    # Each sample depends on the parameters and on the initial state of its own window.
    rows = problem.windows.valid[0].numel()
    sparsity = np.zeros((len(problem.windows) * rows + count, count + size))
    sparsity[:, :count] = 1
    for w in range(len(problem.windows)):
        sparsity[w * rows : (w + 1) * rows, count + 2 * w : count + 2 * w + 2] = 1
    rough = [found.estimates[n].value * 1.03 for n in ASKED]
    start = np.concatenate([rough, found.fit.state.numpy().ravel()])
    scale = np.concatenate([[found.estimates[n].sd for n in ASKED], np.full(size, 1e-3)])
    theirs = least_squares(
        residuals, start, x_scale=scale, jac_sparsity=sparsity, xtol=1e-10, ftol=1e-10, gtol=1e-6
    )
    assert 2.0 * theirs.cost == pytest.approx(found.fit.cost, abs=1e-3)
    for name, value in zip(ASKED, theirs.x, strict=False):
        assert found.estimates[name].value == pytest.approx(value, abs=0.02 * found.estimates[name].sd)


def test_loose_in_words_reports_that_only_a_product_is_identified():
    log = pendulum_log()
    known = {"viscous": VISCOUS, "actuation_delay.delay": DELAY}
    result = fit([log], "pendulum", ["mass", "length"], start=known)
    assert len(result.unidentified) == 1
    # Only the product m g l enters, so +1 % of one is -1 % of the other to first order.
    assert result.loose_in_words() == (
        "the data cannot distinguish a change of mass by -1.00 % and length by +1.00 % from no change",
    ) or result.loose_in_words() == (
        "the data cannot distinguish a change of mass by +1.00 % and length by -1.00 % from no change",
    )
    product = result.estimates["mass"].value * result.estimates["length"].value
    assert product == pytest.approx(MASS * 0.0415, rel=5e-3)
    assert result.estimates["mass"].high - result.estimates["mass"].low > 0.1  # the interval is wide too


def test_prior_identifies_a_combination_that_the_data_do_not():
    names = ("mass", "length")
    prior = Prior(("length",), np.array([0.0415]), np.array([[4e-5**2]]))
    known = {"viscous": VISCOUS, "actuation_delay.delay": DELAY}
    result = fit([pendulum_log()], "pendulum", names, start=known, prior=prior)
    assert result.estimates["mass"].value == pytest.approx(MASS, rel=5e-3)
    assert result.loose_in_words() == ("the estimate of length comes from its prior, not from the data",)


def test_fit_distinguishes_a_late_channel_from_late_commands():
    log = rod_log(mass=1.1)
    theta = log.channels["theta"]
    late = {**log.channels, "theta": Series(theta.t + 0.008, theta.value, "rad", "measurement")}
    result = fit([Recording(late)], "rod_pendulum", ["mass", "actuation_delay.delay", "theta.delay"])
    assert result.estimates["theta.delay"].value == pytest.approx(0.008, abs=0.001)
    assert result.estimates["actuation_delay.delay"].value == pytest.approx(0.0, abs=0.001)
    assert result.estimates["mass"].value == pytest.approx(1.1, rel=0.02)


def test_fit_recovers_the_encoder_zero_of_each_log():
    logs = [rod_log(seed=1), rod_log(seed=2)]
    shifted = []
    for log, zero in zip(logs, (0.05, -0.03), strict=True):
        theta = log.channels["theta"]
        shifted.append(
            replace(log, channels={**log.channels, "theta": replace(theta, value=theta.value + zero)})
        )
    result = fit(shifted, "rod_pendulum", ["mass"], zero_sd=0.1)
    assert [z.value for z in result.zeros] == pytest.approx([0.05, -0.03], abs=0.002)
    for zero, true in zip(result.zeros, (0.05, -0.03), strict=True):
        assert zero.sd < 0.001
        assert abs(zero.value - true) < 4.0 * zero.sd


def test_varies_recovers_the_value_of_each_log_and_the_mean():
    true = (0.0, 0.06, 0.04)
    logs = [rod_log(seed=k, viscous=v) for k, v in enumerate(true, start=1)]
    shared = fit(logs, "rod_pendulum", ["mass", "viscous"])
    assert shared.of_logs == ()
    assert shared.dispersion.chi2_per_sample > 5.0
    result = fit(logs, "rod_pendulum", ["mass", "viscous"], varies={"viscous": 0.03})
    assert result.dispersion.chi2_per_sample < 1.2
    assert [e.name for e in result.of_logs] == [f"viscous of log {k}" for k in (1, 2, 3)]
    for own, value in zip(result.of_logs, true, strict=True):
        assert own.unit == "N m s/rad"
        assert abs(own.value - value) < 4.0 * own.sd < 0.01
    mean = result.estimates["viscous"]
    # The value of each log is precise. The uncertainty of the mean comes from the number of logs.
    assert mean.value == pytest.approx(np.mean(true), abs=1e-3)
    assert mean.sd == pytest.approx(0.03 / np.sqrt(3), rel=0.05)
    assert result.estimates["mass"].value == pytest.approx(1.0, rel=0.01)
    said = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert said["of_logs"]["viscous of log 2"]["value"] == result.of_logs[1].value


def test_varies_accepts_a_parameter_that_is_not_fitted():
    logs = [rod_log(seed=k, viscous=v) for k, v in enumerate((0.01, 0.05), start=1)]
    result = fit(logs, "rod_pendulum", ["mass"], start={"viscous": 0.03}, varies={"viscous": 0.03})
    assert list(result.estimates) == ["mass"]
    assert result.system.parameter("viscous").value == 0.03
    assert [e.value for e in result.of_logs] == pytest.approx([0.01, 0.05], abs=1e-3)
    # `before` uses one shared value for both logs.
    before, after, _ = result.rms["theta"]
    assert before > 2.0 * after


def test_deflation_does_not_widen_the_prior_of_differences():
    logs = [rod_log(seed=k, viscous=v) for k, v in enumerate((0.01, 0.03, 0.05), start=1)]
    # A wrong length gives residuals far above the noise.
    result = fit(logs, "rod_pendulum", ["viscous"], start={"length": 1.1}, varies={"viscous": 0.03})
    assert result.dispersion.deflation > 20.0
    assert result.estimates["viscous"].sd < 1.5 * 0.03 / np.sqrt(3)


def test_varies_gives_no_value_for_a_log_at_rest():
    still = rod_log(seed=3)
    resting = {
        name: replace(c, value=np.zeros_like(c.value) if name != "theta" else np.full_like(c.value, np.pi))
        for name, c in still.channels.items()
    }
    logs = [rod_log(seed=1, viscous=0.01), replace(still, channels=resting), rod_log(seed=2, viscous=0.05)]
    result = fit(logs, "rod_pendulum", ["viscous"], varies={"viscous": 0.03})
    assert [e.name for e in result.of_logs] == ["viscous of log 1", "viscous of log 3"]
    with pytest.raises(FitError, match="moves in only one log"):
        fit(logs[:2], "rod_pendulum", ["viscous"], varies={"viscous": 0.03})


def test_fit_keeps_bounds_and_reports_at_bound():
    result = fit([rod_log(mass=1.1)], "rod_pendulum", ["mass"], bounds={"mass": (0.9, 1.05)})
    estimate = result.estimates["mass"]
    assert estimate.value == pytest.approx(1.05)
    assert estimate.at_bound
    assert estimate.high <= 1.05


def test_fitted_system_can_be_saved_and_fitted_again(found: Identification, tmp_path):
    save_model(tmp_path / "model.yaml", found.system)
    again = load_model(tmp_path / "model.yaml")
    assert again.parameter("actuation_delay.delay").value == found.estimates["actuation_delay.delay"].value
    result = fit([pendulum_log()], again, ["mass"])
    assert result.estimates["mass"].value == pytest.approx(found.estimates["mass"].value, rel=1e-3)


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        (["mas"], {}, 'has no parameter "mas"; did you mean mass'),
        (["delay"], {}, "did you mean .*actuation_delay.delay"),
        ([], {}, "no parameter to fit"),
        (["mass"], {"bounds": {"mass": (2.0, 1.0)}}, "the lower one must be below"),
        (["mass"], {"bounds": {"mass": (0.5, 99.0)}}, "exceed the admissible range, 0.1 to 10"),
        (["mass"], {"start": {"mass": 50.0}}, "start 50 kg is outside 0.1 to 10"),
        (["mass"], {"window": 7.0}, "a fit needs at least 2"),
        (["mass"], {"varies": {"mass": 0.1}}, "needs at least two logs"),
        (["mass"], {"varies": {"mass": 0.0}}, "the standard deviation 0 kg must be positive"),
        (["mass"], {"varies": {"lag.time_constant": 0.1}}, "cannot differ from log to log"),
        (["mass"], {"varies": {"mas": 0.1}}, "did you mean mass"),
        (
            ["mass"],
            {"varies": {"viscous": 0.1}, "prior": Prior(("viscous",), np.zeros(1), np.eye(1))},
            "viscous: varies, but is not among",
        ),
    ],
)
def test_fit_refuses_wrong_requests(names, options, message):
    with pytest.raises(FitError, match=message):
        fit([rod_log()], "rod_pendulum", names, **options)


def test_fit_does_not_change_the_given_system():
    system = make_system("rod_pendulum")
    before = system.parameters
    fit([rod_log()], system, ["mass"], bounds={"mass": (0.5, 2.0)})  # type: ignore[arg-type]
    assert system.parameters == before

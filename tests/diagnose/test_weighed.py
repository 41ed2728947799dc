"""A unit of a model file: a hidden cause is not taken up by the priors, and what any unit has is not named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.causes.parameter import CHANGED
from deepkoco.diagnose.causes.tolerance import Healthy, usual_sd
from deepkoco.diagnose.data_sheet import guessed, with_usual_spread
from deepkoco.diagnose.evidence.priors import strained
from deepkoco.diagnose.little_of_all import with_little
from deepkoco.diagnose.nothing_at_once import Weights
from deepkoco.diagnose.probability.answer import Answer, Weighed
from deepkoco.diagnose.probability.shadow import log_prior_of_losses
from deepkoco.diagnose.verdict.advice import possible_advice
from deepkoco.diagnose.weighed import _plausible
from deepkoco.fit import cut_windows
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import Parameter, load_system, make_system
from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.hidden_cause.cases import draw_case

mujoco = mujoco_library()

XML = """<mujoco model="link"><option timestep="0.0005"/><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" damping="0.05" armature="0.002"/>
  <inertial pos="0.15 0 0" mass="0.8" diaginertia="0.0001 0.006 0.006"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2"/></actuator></mujoco>"""


def log_of(damping=0.0, seconds=14.0, rate=100.0, seed=5, lag=1e-3):
    """A log of MuJoCo's own motion: every unit is 1 % heavier and has a lag [s]; ``damping`` [N m s/rad] is hidden."""
    model = mujoco.MjModel.from_xml_string(XML)
    model.body_mass[1] *= 1.01
    model.dof_damping[0] += damping
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    steps, force, sent, shown = round(1.0 / (rate * model.opt.timestep)), 0.0, [], []
    keep = math.exp(-model.opt.timestep / lag)
    for i in range(round(seconds * rate)):
        if i % 30 == 0:
            wanted = float(rng.uniform(-1.6, 1.6))
        sent.append(wanted)
        shown.append(data.qpos[0] + 2e-4 * rng.standard_normal())
        for _ in range(steps):
            force = wanted + (force - wanted) * keep
            data.ctrl[0] = force
            mujoco.mj_step(model, data)
    t = np.arange(len(sent)) / rate
    return Recording(
        {
            "motor": Series(t, np.array(sent), "N m", "command"),
            "q_hinge": Series(t, np.array(shown), "rad", "measurement"),
        },
        None,
        None,
        {},
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("robot") / "link.xml"
    file.write_text(XML)
    return file


def test_priors_of_a_model_file_are_guessed_until_someone_states_them(path, tmp_path):
    assert all(p.guessed for p in load_system(path).parameters)
    assert not any(p.guessed for p in make_system("rod_pendulum").parameters)
    own = tmp_path / "link.xml"
    own.write_text(XML)
    own.with_name("link.parameters.yaml").write_text(
        "parameters:\n  damping(hinge): {prior_sd: 0.01}\n  armature(hinge): {value: 0.003}\n"
    )
    known = {p.name: p.guessed for p in load_system(own).parameters}
    assert not known["damping(hinge)"]
    assert known["armature(hinge)"]


def test_guessed_priors_become_those_of_units_of_one_make(path):
    system = load_system(path)
    windows = cut_windows([log_of(seconds=6.0)], system, 1.0)
    start = with_gauges_fixed(baseline_from(system, windows), windows)
    usual = with_usual_spread(start)
    sd = dict(zip(usual.prior.names, np.sqrt(usual.prior.covariance.diagonal()), strict=True))
    assert sd["mass(link)"] == pytest.approx(0.02 * 0.8)
    assert sd["damping(hinge)"] == pytest.approx(0.1 * 0.05)
    assert usual.gauges == ()
    assert guessed(start)
    bench = baseline_from(make_system("rod_pendulum"), windows.take(np.zeros(len(windows), dtype=bool)))
    assert not guessed(bench)
    assert np.array_equal(with_usual_spread(bench).prior.covariance, bench.prior.covariance)


@given(st.floats(0.01, 10.0), st.floats(0.01, 2.0))
def test_a_changed_parameter_is_tolerated_within_what_is_known_of_it(value, share):
    stated = Parameter("mass", value, "kg", 0.0, 100.0, share * value, "m")
    assert CHANGED.tolerance(Healthy(stated, 1.0, 0.01, {})) == stated.prior_sd
    guess = replace(stated, guessed=True)
    assert CHANGED.tolerance(Healthy(guess, 1.0, 0.01, {})) == usual_sd(guess) == pytest.approx(0.02 * value)


@pytest.mark.parametrize("value", [0.0, 0.002, -0.002])
def test_a_place_near_its_axis_is_no_better_known_than_one_on_it(value):
    # 2 % of 2 mm were 0.04 mm: a refit took a quarter of a motor rather than move the centre of mass of its camera.
    place = Parameter("com_x(camera)", value, "m", -0.3, 0.3, 0.006, "x")
    assert usual_sd(place) == pytest.approx(0.0006)
    assert usual_sd(replace(place, value=0.2)) == pytest.approx(0.004)


def answer(*weights):
    """Explanations with their log weights, best first."""
    found = [Weighed(causes, weight, True, (0.0, 0.0), {}) for causes, weight in weights]
    return Answer.of(found, len(found), 0.0)


@pytest.mark.parametrize(
    ("weights", "names"),
    [
        # What others add to the simplest one is no rival of it.
        ([(("coulomb", "gain"), 0.0), (("coulomb", "lag"), -1.0), (("coulomb",), -2.0)], {"coulomb"}),
        # What stands in its place is.
        ([(("coulomb",), 0.0), (("gain",), -2.0), (("lag",), -20.0)], {"coulomb", "gain"}),
        # Without a simpler one that weighs nearly as much, both causes are needed.
        ([(("coulomb", "gain"), 0.0), (("coulomb",), -50.0), ((), -1.0)], {"coulomb", "gain"}),
    ],
)
def test_plausible_causes(weights, names):
    causes = list(catalogue(make_system("rod_pendulum")).values())
    assert {c.name for c in _plausible(answer(*weights), causes)} == names


def test_a_prior_that_counts_as_much_as_correlated_samples_strains_as_before(path):
    system = load_system(path)
    windows = cut_windows([log_of(seconds=6.0)], system, 1.0)
    start = with_gauges_fixed(baseline_from(system, windows), windows)
    problem = FitProblem(start.system, windows)
    fit = problem.evaluate(start.values)
    narrow = with_little(start, {}, 9.0)
    assert narrow.narrowing == 9.0
    assert np.allclose(narrow.prior.covariance, start.prior.covariance / 9.0)
    for penalty in (24.0, 26.0):
        told = [
            strained(problem, s, replace(fit, penalty=p))
            for s, p in ((start, penalty), (narrow, 9.0 * penalty))
        ]
        assert told == [penalty > 25.0] * 2
    # Healthy logs have divided their prior by the correlation before.
    assert with_little(replace(start, correlation=3.0), {}, 9.0).narrowing == 3.0


@pytest.mark.parametrize(("shift", "far"), [(0.02, False), (0.15, True)])
def test_a_refit_far_from_units_of_one_make_is_strained_under_a_guessed_prior(path, shift, far):
    system = load_system(path)
    windows = cut_windows([log_of(seconds=6.0)], system, 1.0)
    start = with_gauges_fixed(baseline_from(system, windows), windows)
    problem = FitProblem(start.system, windows)
    # 15 % of a mass is 1.5 standard deviations of its guessed prior, and 7.5 spreads of units of one make.
    fit = problem.evaluate({**start.values, "mass(link)": (1.0 + shift) * start.values["mass(link)"]})
    assert strained(problem, start, replace(fit, penalty=0.0)) is far


def test_a_pattern_of_losses_pays_for_its_code_and_for_a_further_cause():
    assert log_prior_of_losses(0.0, 60) == pytest.approx(math.log(0.3 / 60.0))
    assert log_prior_of_losses(200.0, 60) == pytest.approx(math.log(0.3 / 60.0) - 100.0)


def test_causes_that_are_not_excluded_are_told():
    (text,) = possible_advice(answer(((), 0.0), (("payload",), -1.0), (("lag",), -5.0), (("unknown",), -1.0)))
    assert "payload (21 %)" in text
    assert "lag" not in text
    assert "unknown" not in text
    assert possible_advice(answer(((), 0.0), (("payload",), -9.0))) == ()


@pytest.mark.study
@pytest.mark.long
def test_a_fall_of_the_bic_that_is_asked_for_counts_after_the_weighing_too(path):
    asked = diagnose([log_of(damping=0.04)], load_system(path), detection=1e6)
    assert set(asked.names) <= {"unknown"}


@pytest.mark.study
@pytest.mark.long
@pytest.mark.parametrize(("number", "names"), [(60, ()), (71, ("viscous",)), (1, ("actuation_delay",))])
def test_small_effects_of_a_unit_are_no_lost_commands_and_a_delay_is_no_filter(number, names, tmp_path):
    # A log of 16 s shows a lag of 1 ms, a bias and a drag together, and none of them alone: a loss imitated them. A
    # delay of 8 ms moves the commands into the steps.
    handed = draw_case(34000, number, 16.0).question(tmp_path).handed
    assert diagnose(list(handed.log), handed.system).names == names


@pytest.mark.study
@pytest.mark.long
def test_damping_within_its_guessed_prior_is_named_and_what_any_unit_has_is_not(path):
    system = load_system(path)
    times = []
    for seed in (4, 5, 6):
        steps: list[str] = []
        healthy = diagnose([log_of(seed=seed)], system, evidence=True, progress=steps.append)
        assert (healthy.verdict, healthy.causes) == ("nothing", ())
        # No name is looked for where none can follow: causes are taken into the fit as they come.
        assert not any("again" in step for step in steps)
        chosen = [k for k, step in enumerate(steps) if step.startswith("class of")]
        assert all(k > steps.index("weighing the data sheet") for k in chosen)
        # The report shows the weights with which this was decided: no cause weighs as much.
        assert healthy.evidence is not None
        times.append(healthy.evidence["nothing"] / max(c["probability"] for c in healthy.evidence["causes"]))
    # The noise of seed 5 looks like a delay; "nothing" is not twice as probable there, and fifty times elsewhere.
    assert min(times) > 1.0
    assert sorted(times)[1] > 20.0
    # One and a half standard deviations of the guessed prior of servos' and joints' dampings: the refit takes it up.
    worn = diagnose([log_of(damping=0.04)], system)
    assert worn.verdict == "cause"
    assert {"viscous", "changed(damping(hinge))"} & set(worn.causes[0].members)
    assert worn.causes[0].parameters["viscous.change"].value == pytest.approx(0.04, rel=0.15)


@pytest.mark.parametrize(("lag", "verdict"), [(1e-3, "nothing"), (6e-3, "cause")])
def test_a_rough_file_makes_no_fault_of_what_any_unit_has(path, monkeypatch, lag, verdict):
    # Where a rough file weighs most, the first selection stands: a lag of a millisecond was its name (50000/66).
    monkeypatch.setattr(Weights, "rough", lambda self, causes: math.inf)
    result = diagnose([log_of(lag=lag)], str(path), only=["lag", "viscous", "coulomb"])
    assert result.verdict == verdict
    assert (*result.names, *(m["name"] for m in result.unexplained["minor"])) == ("lag",)

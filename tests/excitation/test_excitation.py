"""Excitations: within the limits, reproducible, and moving the unit through its range."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.excitation import EXCITATIONS, ExcitationError, make_excitation, policy_excitation
from deepkoco.excitation.policy import load_policy_excitation
from deepkoco.excitation.record import record
from deepkoco.excitation.signal import natural_frequency
from deepkoco.koopman import KoopmanModel, ModelConfig, export_model
from deepkoco.koopman.files.model_folder import write_model_folder
from deepkoco.systems import make_system
from deepkoco.unit import make_unit

SYSTEMS = ("pendulum", "rod_pendulum", "torque_pendulum")


def commands(kind, system="rod_pendulum", seed=0, amplitude=None):
    excitation = make_excitation(kind, system, 20.0, seed, amplitude)
    measurement = np.random.default_rng(1).normal(0.0, 2.0, (400, 2))
    return [excitation(0.05 * k, measurement[k]) for k in range(400)]


@given(
    kind=st.sampled_from(sorted(EXCITATIONS)),
    system=st.sampled_from(SYSTEMS),
    seed=st.integers(0, 10**6),
    share=st.floats(0.05, 1.0),
)
@settings(max_examples=40, deadline=None)
def test_commands_stay_within_the_amplitude(kind, system, seed, share):
    amplitude = share * make_system(system).command.high
    assert max(map(abs, commands(kind, system, seed, amplitude))) <= amplitude * (1 + 1e-12)


@pytest.mark.parametrize("kind", sorted(EXCITATIONS))
def test_same_seed_same_commands(kind):
    assert commands(kind, seed=3) == commands(kind, seed=3)
    assert commands(kind, seed=3) != commands(kind, seed=4)


def test_natural_frequency_of_the_rod():
    assert natural_frequency(make_system("rod_pendulum")) == pytest.approx(math.sqrt(15.0))


def test_chirp_is_continuous_over_its_turns():
    excitation = make_excitation("chirp", "rod_pendulum", 60.0)
    t = np.arange(0.0, 60.0, 1e-3)
    values = np.array([excitation(x, (math.pi, 0.0)) for x in t])
    fastest = 3.0 * math.sqrt(15.0) * 2.0  # largest slope of 2 sin(phase) [N m/s]
    assert np.abs(np.diff(values)).max() <= fastest * 1e-3 * 1.001


def test_chirp_sweeps_through_the_natural_frequency():
    excitation = make_excitation("chirp", "rod_pendulum", 20.0)
    values = np.array([excitation(x, (math.pi, 0.0)) for x in np.arange(0.0, 20.0, 0.01)])
    spectrum = np.abs(np.fft.rfft(values)) ** 2
    omega = 2.0 * math.pi * np.fft.rfftfreq(len(values), 0.01) / math.sqrt(15.0)
    inside = (omega > 0.2) & (omega < 3.2)
    assert spectrum[inside].sum() > 0.9 * spectrum.sum()
    for low, high in ((0.5, 1.0), (1.0, 2.0), (2.0, 3.0)):
        assert spectrum[(omega >= low) & (omega < high)].sum() > 0.05 * spectrum.sum()


def test_steps_use_several_levels_and_prbs_two():
    assert len({round(c, 9) for c in commands("steps")} - {2.0, -2.0}) >= 4
    assert set(commands("prbs")) == {2.0, -2.0}


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("kind", sorted(EXCITATIONS))
def test_excitation_is_informative(kind, system):
    # Also where the command cannot lift the pendulum (rod: 2 N m against 5 N m of gravity).
    recording = record(make_unit(system), kind, 30.0, clock="simulated")
    frequency = natural_frequency(make_system(system))
    theta, omega = recording.channels["theta"].value, recording.channels["omega"].value
    assert np.ptp(theta) > 1.5
    assert 0.3 < omega.std() / frequency < 3.0
    assert np.abs(omega).max() < 4.0 * frequency
    assert (omega > 0.3 * frequency).mean() > 0.1
    assert (omega < -0.3 * frequency).mean() > 0.1


def test_policy_is_cut_to_the_limits():
    excitation = policy_excitation(lambda measurement: 10.0 * measurement[0], (-2.0, 2.0))
    assert [excitation(0.0, (x, 0.0)) for x in (-1.0, 0.1, 1.0)] == [-2.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("sweep", "rod_pendulum", 5.0), 'unknown excitation "sweep"; known: chirp, steps, prbs, bang-bang'),
        (("chirp", "rod_pendulum", 5.0, 0, 3.0), r"amplitude 3 N m is outside \(0, 2\] N m of rod_pendulum"),
        (("chirp", "rod_pendulum", 5.0, 0, 0.0), "amplitude 0 N m is outside"),
    ],
)
def test_bad_excitation_is_named(arguments, message):
    with pytest.raises(ExcitationError, match=message):
        make_excitation(*arguments)


def test_trained_policy_drives_the_unit_at_its_own_rate(tmp_path):
    torch.manual_seed(0)
    model = export_model(KoopmanModel(3, 1, ModelConfig(3, 0.04, (8,), (6,))))
    write_model_folder(
        model, tmp_path / "policy", {"planner": {}, "action_low": [-2.0], "action_high": [2.0]}
    )
    excitation, rate = load_policy_excitation(tmp_path / "policy", "rod_pendulum")
    recording = record(make_unit("rod_pendulum"), excitation, 2.0, clock="simulated", control_rate=rate)
    torque = recording.channels["torque"].value
    assert rate == pytest.approx(25.0)
    assert len(torque) == 51
    assert np.ptp(torque) > 0.0
    assert np.abs(torque).max() <= 2.0


def test_policy_for_other_observations_is_refused(tmp_path):
    model = export_model(KoopmanModel(15, 1, ModelConfig(3, 0.05, (8,), (6,))))
    write_model_folder(
        model, tmp_path / "policy", {"planner": {}, "action_low": [-2.0], "action_high": [2.0]}
    )
    with pytest.raises(ExcitationError, match="takes 15 observations, rod_pendulum gives 3"):
        load_policy_excitation(tmp_path / "policy", "rod_pendulum")


@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (-1.5, 1.5), (-2.0, 1.0)])
def test_policy_in_other_units_or_for_other_limits_is_refused(tmp_path, low, high):
    model = export_model(KoopmanModel(3, 1, ModelConfig(3, 0.05, (8,), (6,))))
    write_model_folder(
        model, tmp_path / "policy", {"planner": {}, "action_low": [low], "action_high": [high]}
    )
    with pytest.raises(ExcitationError, match=r"commands of rod_pendulum in \[-2\] to \[2\] N m; .*physical"):
        load_policy_excitation(tmp_path / "policy", "rod_pendulum")

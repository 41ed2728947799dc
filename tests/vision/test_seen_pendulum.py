"""Fits of a seen pendulum: what a log identifies, and what it leaves open."""

import math

import numpy as np
import pytest
import torch

from deepkoco.fit import fit
from deepkoco.logs.recording import Recording, Series
from deepkoco.vision import SeenPendulum, angle_of_pixel, identify_seen, known_of_sensors, pixel_of_angle

SECONDS = 9.0
ACTUATION, CAMERA = 0.007, 0.011  # [s]
TRUE = {"roll": 0.06, "pivot_u": 3.0, "tilt_u": 0.14, "tilt_v": 0.05, "perspective": 0.13}
SOUGHT = ("motor_constant", "roll", "pivot_u", "tilt_u", "tilt_v", "camera_delay", "actuation_delay.delay")
START = {"coulomb": 0.0, "perspective": 0.13}


@pytest.fixture(scope="module")
def log() -> Recording:
    """A pendulum without dry friction, by small steps of its own; pixels from the camera model, with noise."""
    random = np.random.default_rng(3)
    inertia, weight, k, r, b = 1.599e-4, 0.0509 * 9.81 * 0.0415, 0.0333, 7.73, 1.43e-5
    sent = np.arange(0.0, SECONDS, 0.02)
    volts = np.repeat(random.choice([-2.5, -1.0, 1.0, 2.5], len(sent) // 12 + 1), 12)[: len(sent)]
    h = 2e-4
    t = np.arange(0.0, SECONDS, h)
    u = np.concatenate([[0.0], volts])[np.searchsorted(sent + ACTUATION, t + 1e-9)]
    theta, omega, states = math.pi - 0.3, 0.0, np.empty((len(t), 2))
    for i in range(len(t)):
        states[i] = theta, omega
        omega += h * (u[i] * k / r + weight * math.sin(theta) - (b + k * k / r) * omega) / inertia
        theta += h * omega
    frames, ticks = np.arange(0.1, SECONDS, 0.02), np.arange(0.1, SECONDS, 0.01)
    shown = torch.from_numpy(np.interp(frames - CAMERA, t, states[:, 0]))
    nominal = SeenPendulum().nominal_camera
    own = nominal | {n: torch.tensor(v, dtype=torch.float64) for n, v in TRUE.items()}
    pixel = [p + 0.05 * torch.from_numpy(random.normal(size=len(p))) for p in pixel_of_angle(shown, own)]
    bearing, reach = angle_of_pixel(*pixel, nominal)
    speed = np.interp(ticks, t, states[:, 1]) + random.normal(0.0, 0.05, len(ticks))
    return Recording(
        {
            "voltage": Series(sent, volts, "V", "command"),
            "bearing": Series(frames, np.unwrap(bearing.numpy()), "rad", "measurement"),
            "reach": Series(frames, reach.numpy(), "1", "measurement"),
            "omega": Series(ticks, speed, "rad/s", "measurement"),
        }
    )


def test_camera_and_both_delays_are_found(log):
    found = identify_seen([log], SOUGHT, start=START)
    value = {name: e.value for name, e in found.estimates.items()}
    assert value["camera_delay"] == pytest.approx(CAMERA, abs=5e-4)
    assert value["actuation_delay.delay"] == pytest.approx(ACTUATION, abs=5e-4)
    assert value["motor_constant"] == pytest.approx(0.0333, rel=0.01)
    for name in ("roll", "tilt_u", "tilt_v"):
        assert value[name] == pytest.approx(TRUE[name], abs=0.02)
    assert value["pivot_u"] == pytest.approx(TRUE["pivot_u"], abs=0.3)


def test_of_two_poses_that_look_alike_the_likelier_one_is_taken(log):
    """A fit that starts at the mirrored pose ends there, with a worse cost; the other start leads out of it."""
    sought = (*SOUGHT, "perspective", "lens", "scale")
    mirrored = {"coulomb": 0.0, "tilt_u": -TRUE["tilt_u"], "tilt_v": -TRUE["tilt_v"]}
    alone = fit([log], SeenPendulum(), sought, prior=known_of_sensors(sought), start=mirrored)
    assert alone.estimates["tilt_u"].value < 0.0
    found = identify_seen([log], sought, start=mirrored)
    assert found.estimates["tilt_u"].value == pytest.approx(TRUE["tilt_u"], abs=0.02)
    assert found.rms["reach"][1] < alone.rms["reach"][1]


def test_a_camera_alone_identifies_the_sum_of_the_delays(log):
    seen = Recording({name: s for name, s in log.channels.items() if name != "omega"})
    found = identify_seen([seen], SOUGHT, start=START)
    names = ("camera_delay", "actuation_delay.delay")
    delays = [found.estimates[name] for name in names]
    assert sum(e.value for e in delays) == pytest.approx(ACTUATION + CAMERA, abs=5e-4)
    assert min(e.sd for e in delays) > 5e-3
    row, column = (list(found.estimates).index(name) for name in names)
    assert found.correlation[row, column] < -0.99


def test_the_prior_is_that_of_the_sensors_without_the_delay():
    prior = known_of_sensors(("mass", "roll", "camera_delay", "tacho_gain"))
    assert prior is not None
    assert prior.names == ("roll", "tacho_gain")
    assert known_of_sensors(("mass", "camera_delay")) is None

"""Large problems: simulated a few lanes at a time, and points before their slopes."""

import numpy as np
import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.fit import Prior, Trial, cut_windows, shooting
from deepkoco.fit.request import make_request
from deepkoco.fit.shooting import ShootingProblem
from deepkoco.fit.solve import levenberg_marquardt
from deepkoco.fit.tangent import Tangent, batches, simulated
from deepkoco.systems import ExtendedSystem, make_system
from tests.fit.identify_logs import rod_log


@pytest.fixture(scope="module")
def problem():
    return make_request([rod_log(4.0, 0)], "rod_pendulum", ["mass", "viscous"]).problem()


def values_of(problem) -> dict[str, float]:
    known = {p.name: p.value for p in problem.system.parameters}
    return {name: known.get(name, 0.0) for name in problem.names}


@pytest.mark.parametrize(
    ("lanes", "most", "wanted"),
    [([3, 3, 3], 6, [[0, 1], [2]]), ([9, 1, 1], 2, [[0], [1, 2]]), ([], 5, []), ([4], 1, [[0]])],
)
def test_neighbours_share_a_batch_up_to_its_size(lanes, most, wanted):
    assert [some.tolist() for some in batches(lanes, most)] == wanted


def test_the_size_of_batches_changes_no_simulation(problem, monkeypatch):
    columns = np.array([problem.names.index(n) for n in ("mass", "viscous")])
    theta = np.array(list(values_of(problem).values()))
    tangent = Tangent.at(problem, theta, columns, problem.windows.state)
    whole = simulated(problem, [tangent], problem.nuisances.none()[None])
    monkeypatch.setattr(shooting, "MEASUREMENTS", 2 * problem.windows.value.numel())
    assert problem.most_lanes == 2
    torch.testing.assert_close(
        simulated(problem, [tangent], problem.nuisances.none()[None]), whole, rtol=1e-12, atol=0.0
    )


class Branching(System):
    """A rod whose equations ask for values, so that no trace shows them and torch takes its steps."""

    joint_units = ("rad",)
    parameters = (Parameter("gravity", 15.0, "1/s^2", 0.0, 50.0, 1.0, "over the length"),)
    commands = (Channel("torque", "N m", "command", -1.0, 1.0),)
    measurements = (Channel("theta", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        def law(motion):
            swing = p["gravity"] * torch.sin(motion.angles[0])
            swing = swing if bool(torch.isfinite(swing).all()) else torch.zeros_like(swing)
            return (motion.efforts[0] - swing + motion.load(0),)

        return law


def test_batches_are_larger_where_torch_takes_the_steps():
    """Each operation has a cost of its own there. Of 600000 samples, 21 lanes take 0.49 s at once, 1.1 s by threes."""
    measurements = []
    for system in (make_system("rod_pendulum"), Branching()):
        windows = cut_windows([rod_log(4.0, 0)], system, 1.0)
        measurements.append(
            ShootingProblem(ExtendedSystem(system, ()), windows).most_lanes * windows.value.numel()
        )
    assert measurements[1] > 4 * measurements[0]


def test_a_fit_that_simulates_points_first_ends_at_the_same_place(problem, monkeypatch):
    values = values_of(problem) | {"mass": 2.0}  # far away, so that steps are rejected
    free = ("mass", "viscous")
    prior = Prior.of([problem.system.parameter(n) for n in free])
    trial = Trial("far", free, prior, values)
    fits = {}
    for share in (np.inf, 0.0):
        monkeypatch.setattr(levenberg_marquardt, "LARGE", share)
        fits[share] = problem.fit([trial])[0]
    there, here = fits[np.inf], fits[0.0]
    assert any(a == b for a, b in zip(there.history, there.history[1:], strict=False))  # some were
    assert here.converged
    assert here.cost == pytest.approx(there.cost, rel=1e-4)
    assert here.values["mass"] == pytest.approx(there.values["mass"], rel=1e-3)

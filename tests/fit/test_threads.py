"""one_thread: torch has one thread, simulations have as many as torch had, and no result depends on how many."""

import numpy as np
import pytest
import torch

from deepkoco.fit import FitProblem, cut_windows, shooting
from deepkoco.fit.request import make_request
from deepkoco.fit.threads import at_once, in_parts, one_thread
from deepkoco.systems import ExtendedSystem, load_system
from tests.fit.identify_logs import rod_log
from tests.oracle.feeder import feeder_log, model_file


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def _fail_on_one_thread() -> None:
    with one_thread():
        raise ArithmeticError(f"{torch.get_num_threads()} thread")


def test_one_thread_restores_the_number_of_threads(two_threads):
    with pytest.raises(ArithmeticError, match=r"^1 thread$"):
        _fail_on_one_thread()
    assert torch.get_num_threads() == 2


def test_each_call_is_made_once_with_one_thread_of_torch(two_threads):
    made, threads = [], []

    def call(k: int) -> None:
        made.append(k)
        threads.append(torch.get_num_threads())

    with one_thread():
        at_once(call, 20)
    assert sorted(made) == list(range(20))
    assert set(threads) == {1}


@pytest.mark.parametrize(("count", "most", "parts"), [(7, 3, 3), (6, 3, 2), (2, 5, 1), (23, 1, 23)])
def test_parts_cover_every_item_once_and_are_no_larger_than_allowed(count, most, parts, two_threads):
    covered = []
    with one_thread():
        in_parts(lambda at, end: covered.append(range(at, end)), count, most)
    assert sorted(k for part in covered for k in part) == list(range(count))
    assert len(covered) == parts
    assert max(map(len, covered)) <= most


def test_an_error_of_a_call_is_raised(two_threads):
    def call(k: int) -> None:
        if k == 3:
            raise ArithmeticError("call 3")

    with one_thread(), pytest.raises(ArithmeticError, match="call 3"):
        at_once(call, 5)


def _of_bytecode(folder):
    return make_request([rod_log(4.0, 0)], "rod_pendulum", ["mass", "viscous"]).problem()


def _of_a_tree(folder):
    system = load_system(model_file(folder))
    return FitProblem(ExtendedSystem(system, ()), cut_windows([feeder_log(4.0)], system, 1.0))


@pytest.mark.parametrize("make", [_of_bytecode, _of_a_tree])
def test_simulations_have_the_same_bits_whatever_the_number_of_threads(
    make, two_threads, monkeypatch, tmp_path
):
    problem = make(tmp_path)
    known = {p.name: p.value for p in problem.system.parameters}
    theta = np.array([[known.get(n, 0.0) for n in problem.names]]).repeat(23, 0)
    theta[:, 0] *= np.linspace(0.8, 1.2, 23)
    state = problem.windows.state[None].repeat(23, 1, 1)
    nuisance = problem.nuisances.none()[None].repeat(23, 1)
    monkeypatch.setattr(shooting, "MEASUREMENTS_EACH", 3 * problem.windows.value.numel())
    alone = problem.predict(theta, state, nuisance)
    with one_thread():
        together = problem.predict(theta, state, nuisance)
    assert alone.numpy().tobytes() == together.numpy().tobytes()
    assert len({lane.numpy().tobytes() for lane in alone}) == 23

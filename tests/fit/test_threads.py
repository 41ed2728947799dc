"""one_thread restores the number of threads, also after an error."""

import pytest
import torch

from deepkoco.fit.threads import one_thread


def _fail_on_one_thread() -> None:
    with one_thread():
        raise ArithmeticError(f"{torch.get_num_threads()} thread")


def test_one_thread_restores_the_number_of_threads():
    before = torch.get_num_threads()
    with pytest.raises(ArithmeticError, match=r"^1 thread$"):
        _fail_on_one_thread()
    assert torch.get_num_threads() == before

"""The number of threads is restored, whatever happens."""

import pytest
import torch

from deepkoco.identify.threads import one_thread


def test_one_thread_inside_and_as_before_outside():
    before = torch.get_num_threads()
    with pytest.raises(ZeroDivisionError), one_thread():
        assert torch.get_num_threads() == 1
        raise ZeroDivisionError
    assert torch.get_num_threads() == before

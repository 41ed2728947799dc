"""What a first call after an installation says while it compiles."""

from numba import njit

from deepkoco.fit.compiling import COMPILING, told_of_compilation


def test_compilation_is_told_once_for_all_functions_that_a_call_compiles():
    @njit
    def inner(x):
        return 2 * x

    @njit
    def outer(x):
        return inner(x) + 1

    said = []
    with told_of_compilation(said.append):
        assert outer(3) == 7
        assert said == [COMPILING]
        assert outer(4) == 9
    outer(0.5)
    assert said == [COMPILING]

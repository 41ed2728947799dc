"""Numbers as a reader wants them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepkoco.pages.units import plain, telling_digits


@pytest.mark.parametrize(
    ("low", "high", "shown"),
    [
        (0.87968, 0.88031, ["0.87968", "0.88031"]),  # 0.88 to 0.88 with four digits
        (1.2, 3.4, ["1.2", "3.4"]),
        (-0.073, -0.0282, ["-0.073", "-0.0282"]),
        (2.0, 2.0, ["2", "2"]),
    ],
)
def test_the_ends_of_an_interval_differ_by_two_digits(low, high, shown):
    digits = telling_digits(low, high)
    assert [plain(v, digits) for v in (low, high)] == shown


@given(st.floats(0.01, 1e4), st.floats(1e-5, 0.5))
def test_an_interval_with_a_width_never_shows_two_equal_ends(centre, share):
    low, high = centre * (1.0 - share), centre * (1.0 + share)
    digits = telling_digits(low, high)
    shown = [float(plain(v, digits).replace(",", "")) for v in (low, high)]
    assert (shown[1] - shown[0]) == pytest.approx(high - low, rel=0.11)

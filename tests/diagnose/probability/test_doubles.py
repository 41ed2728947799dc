"""A changed parameter is no explanation where another cause can add what it needs."""

import numpy as np
import pytest

from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.probability.coordinates import Coordinate, Item
from deepkoco.diagnose.probability.explanations import Explanation
from deepkoco.diagnose.probability.search import Scored
from deepkoco.diagnose.probability.shadow import _is_double
from deepkoco.systems import make_system

CAUSES = catalogue(make_system("rod_pendulum"))
MASS, DRAG = Item(CAUSES["changed(mass)"], (0,), {}, 1), Item(CAUSES["quadratic"], (3,), {}, 1)
PAYLOAD = Coordinate("payload.mass", 1e-6, 0.1, 0.0, 0.5)  # it adds up to half a kilogram


@pytest.mark.parametrize(
    ("amount", "double"),
    [(0.2, True), (-0.2, False), (0.7, False)],
    ids=["heavier", "lighter", "more than it holds"],
)
@pytest.mark.parametrize("beside", [(), (DRAG,)], ids=["alone", "beside another cause"])
def test_a_payload_stands_for_the_mass_that_it_can_add(amount, double, beside):
    explanation = Explanation((*beside, MASS))
    mode = np.array([1.0] * len(beside) + [amount])
    assert _is_double(Scored(explanation, 0.0, 0, mode), {0: [PAYLOAD]}) == double


def test_other_causes_and_parameters_without_a_double_stay():
    assert not _is_double(Scored(Explanation((DRAG,)), 0.0, 0, np.array([0.2])), {0: [PAYLOAD]})
    assert not _is_double(Scored(Explanation((MASS,)), 0.0, 0, np.array([0.2])), {})

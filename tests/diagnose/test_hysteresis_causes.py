"""Springs, bristles, play and limited rates hidden in logs of an integrator of its own are named, with their sizes."""

import pytest

from deepkoco.diagnose import diagnose
from tests.oracle.hysteresis import HIDDEN, SYSTEM, hysteresis_log
from tests.studied import studied

NAMES = {kind: kind.removesuffix("_at_zero") for kind in HIDDEN} | {"": ""}
SIMILAR = ["spring", "bristle", "rate_limit", "gear_play", "coulomb", "lag", "sensor_bias", "torque_bias"]


@pytest.mark.parametrize("kind", studied(HIDDEN, ("gear_play",)))
def test_diagnose_names_the_hidden_cause_among_similar_ones(kind):
    result = diagnose([hysteresis_log(kind, 0)], SYSTEM, window=1.0, only=SIMILAR)
    assert [cause.name for cause in result.causes] == [NAMES[kind]]
    assert result.chi2_after < 1.2
    for name, estimate in result.causes[0].parameters.items():
        assert estimate.value == pytest.approx(HIDDEN[kind][name.split(".")[1]], rel=0.1)


@pytest.mark.parametrize("kind", studied(["", *HIDDEN], ()))
def test_diagnose_names_the_hidden_cause_among_all(kind):
    result = diagnose([hysteresis_log(kind, 1)], SYSTEM, window=1.0)
    assert [cause.name for cause in result.causes] == ([NAMES[kind]] if kind else [])

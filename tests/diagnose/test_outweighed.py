"""No confident name where the log is more probably explained without it: evidence as a witness."""

from types import SimpleNamespace
from typing import cast

import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.probability.answer import Answer, Weighed
from deepkoco.diagnose.verdict.outweighed import outweighed
from experiments.studies.diagnosis.hidden_cause.cases import draw_case

SAMPLES = 1000


def answer(*weights):
    found = [Weighed(causes, weight, True, (0.0, 0.0), {}) for causes, weight in weights]
    return Answer.of(found, len(found), 0.0)


def doubt(weights, classes=(("sensor_scale",),), left=50.0, lost=None, longer=False):
    """The doubt about causes that leave so many noise variances, where noise is 1.1 at most."""
    causes = tuple(SimpleNamespace(name=names[0]) for names in classes)
    found = SimpleNamespace(
        accepted=causes,
        steps=tuple((None, names) for names in classes),
        lost=lost,
        final=SimpleNamespace(chi2=left * SAMPLES),
    )
    base = SimpleNamespace(
        train=SimpleNamespace(samples=SAMPLES), start=SimpleNamespace(most_noise=lambda _: 1.1)
    )
    return outweighed(
        cast(Explanation, SimpleNamespace(base=base, found=found, weights=weights, longer=longer))
    )


def test_a_cause_that_adds_nothing_to_a_smooth_load_is_no_name():
    text = doubt(answer((("unknown",), 0.0), (("sensor_scale", "unknown"), -6.0)))
    assert text is not None
    assert "sensor_scale" in text
    assert "0.0025" in text  # e^-6 / (1 + e^-6)
    assert "smooth load" in text


def test_a_cause_of_another_shape_than_that_of_the_catalogue_stands_beside_a_smooth_load():
    assert doubt(answer((("sensor_scale", "unknown"), 0.0), (("unknown",), -6.0))) is None


def test_the_members_of_a_class_stand_for_each_other():
    weights = answer((("gain", "unknown"), 0.0), (("unknown",), -6.0), (("sensor_scale",), -9.0))
    assert doubt(weights) is not None
    assert doubt(weights, (("sensor_scale", "gain"),)) is None


@pytest.mark.parametrize(
    "given",
    [
        {"left": 1.05},  # it explains the log
        {"longer": True},  # the weights are of shorter windows than the causes
        {"lost": object()},  # lost commands are no explanation that is weighed here
        {"classes": (("sensor_scale",), ("jitter",))},  # one of two was not weighed
    ],
)
def test_what_cannot_be_doubted_stands(given):
    assert doubt(answer((("unknown",), 0.0), (("sensor_scale", "unknown"), -6.0)), **given) is None


def test_without_weights_nothing_is_doubted():
    assert doubt(None) is None


@pytest.mark.study
@pytest.mark.long
def test_a_spring_on_one_side_is_no_scale_of_an_encoder(tmp_path):
    # sensor_scale explains 97 % of the difference, and leaves 24,000 noise variances where the healthy log leaves 1.
    handed = draw_case(45000, 11, 20.0).question(tmp_path).handed
    result = diagnose(list(handed.log), handed.system, healthy=list(handed.healthy))
    assert result.verdict == "unknown"
    assert "sensor" not in str(result.unexplained.get("family"))


@pytest.mark.study
@pytest.mark.long
def test_friction_that_is_not_quite_of_the_catalogue_keeps_its_name_beside_a_healthy_log(tmp_path):
    handed = draw_case(38000, 7, 20.0).question(tmp_path).handed
    result = diagnose(list(handed.log), handed.system, healthy=list(handed.healthy))
    assert result.names == ("bristle",)

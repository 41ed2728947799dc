"""A sensor of which nobody stated the noise is not noisier than stated."""

import numpy as np
import pytest

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.diagnose.data import cut_data
from deepkoco.diagnose.refitted import refit_to_logs
from deepkoco.diagnose.verdict.noise_causes import scatter_findings
from deepkoco.fit.data.windows import window_length
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import load_system

SLIDER = """
<mujoco model="slider"><worldbody><body><joint name="rail" type="slide" axis="1 0 0" damping="4"/>
  <geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator></mujoco>
"""


def noisy_log(step=0.0):
    t = np.arange(0.0, 12.0, 0.01)
    effort, place, speed = 3.0 * np.sin(2.0 * t), [0.0], 0.0
    for u in effort[:-1]:
        end = u / 4.0 + (speed - u / 4.0) * np.exp(-2.0 * 0.01)  # 2 v' = u - 4 v
        place.append(place[-1] + 0.01 * u / 4.0 + (speed - u / 4.0) * (1.0 - np.exp(-2.0 * 0.01)) / 2.0)
        speed = end
    noisy = np.array(place) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    noisy = step * np.round(noisy / step) if step else noisy
    return Recording(
        {"push": Series(t, effort, "N", "command"), "q_rail": Series(t, noisy, "m", "measurement")}
    )


@pytest.mark.parametrize(
    ("noise", "named"), [("", []), ('noise: {"q_rail": 1.0e-4}', ["noise_level(q_rail)"])]
)
def test_noise_is_compared_with_what_somebody_stated(tmp_path, noise, named):
    (tmp_path / "slider.xml").write_text(SLIDER)
    if noise:
        (tmp_path / "slider.parameters.yaml").write_text(noise)
    system = load_system(tmp_path / "slider.xml")
    data = cut_data([noisy_log()], [], system, window_length(system))
    base = refit_to_logs(baseline_from(system, data.train), data)
    found = scatter_findings(base.start.system, base.train, base.reference, 24.0)
    assert [f.name for f in found] == named


@pytest.mark.parametrize("stated", ["2.0e-4", "1.99999998e-4", "2.00000002e-4"])
def test_noise_is_compared_where_somebody_stated_the_step_of_the_sensor_as_its_noise(tmp_path, stated):
    # A step that is found from values differs in its last digits from the stated one.
    (tmp_path / "slider.xml").write_text(SLIDER)
    (tmp_path / "slider.parameters.yaml").write_text(f'noise: {{"q_rail": {stated}}}')
    system = load_system(tmp_path / "slider.xml")
    data = cut_data([noisy_log(2e-4)], [], system, window_length(system))
    base = refit_to_logs(baseline_from(system, data.train), data)
    found = scatter_findings(base.start.system, base.train, base.reference, 24.0)
    assert [f.name for f in found] == ["noise_level(q_rail)"]

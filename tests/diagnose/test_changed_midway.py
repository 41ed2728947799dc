"""A unit that becomes another one in the middle of its log."""

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import baseline_from, refit
from deepkoco.diagnose.verdict.midway import changed_midway, clearest_changes
from deepkoco.excitation.record import record
from deepkoco.fit.data.windows import cut_windows, moving
from deepkoco.logs.recording import Recording
from deepkoco.systems import make_system
from deepkoco.unit import make_unit

WEIGHT = make_system("torque_pendulum").parameter("gravity_torque").value


def log(seed, seconds=10.0, effects=None, **changed):
    sensor = {"rate_hz": 100.0}
    unit = make_unit("torque_pendulum", effects=effects, parameters=changed, sensor=sensor, seed=seed)
    return record(unit, "steps", seconds, clock="simulated", seed=seed)


def joined(first, second, seconds=10.0):
    """One log after the other, as one recording."""
    channels = {}
    for name, a in first.channels.items():
        b = second.channels[name]
        kept = a.t < seconds
        t, value = np.append(a.t[kept], b.t + seconds), np.append(a.value[kept], b.value)
        channels[name] = replace(a, t=t, value=value)
    return Recording(channels, system=first.system)


def windows_of(recording):
    system = make_system("torque_pendulum")
    windows = cut_windows([recording], system, 1.0)
    windows = windows.take(moving(windows))
    return baseline_from(system, windows), windows


def asked(recording):
    return changed_midway(*windows_of(recording))


def test_a_weight_that_changes_in_the_middle_is_seen_with_its_time_and_its_values():
    found = asked(joined(log(1), log(2, gravity_torque=0.7 * WEIGHT)))
    assert found is not None
    assert found.statistic > 10.0
    begin, end = (float(x) for x in found.text.split("between ")[1].split(" s:")[0].split(" and "))
    assert begin < 10.0 < end
    assert end - begin < 3.0
    assert found.text.startswith("The unit changed in the middle")
    assert f"gravity_torque from {WEIGHT:.2g} to 2.1" in found.text


def test_one_unit_in_two_motions_has_not_changed():
    assert asked(joined(log(1), log(2))) is None


def test_a_unit_that_differs_from_the_simulation_all_along_has_not_changed():
    assert asked(joined(log(1, gravity_torque=0.7 * WEIGHT), log(2, gravity_torque=0.7 * WEIGHT))) is None


def test_parts_that_are_not_explained_up_to_noise_may_have_changed():
    rough = {"coulomb": {"torque": 0.05}}
    found = asked(joined(log(1, effects=rough), log(2, effects=rough, gravity_torque=0.7 * WEIGHT)))
    assert found is not None
    assert found.text.startswith("The unit may have changed in the middle of this log")
    assert "though not down to the noise" in found.text


def test_parameters_that_only_imitate_what_is_missing_do_not_differ_clearly():
    # One unit in two motions: its quadratic drag, which the simulation lacks, looks like another viscous friction.
    given = [windows_of(log(seed, effects={"quadratic": {"drag": 0.01}})) for seed in (1, 2)]
    start, parts = given[0][0], [windows for _, windows in given]
    sides = [refit(start, part) for part in parts]
    assert clearest_changes(start, sides, parts) == ""

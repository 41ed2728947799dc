"""Archives of NumPy, files of MATLAB and HDF5 as logs."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from deepkoco.logs import LogError, read_log, read_logs
from deepkoco.logs.formats import open_log

T = 0.02 * np.arange(150)
ANGLE, SPEED, TORQUE = np.cos(T), -np.sin(T), 0.3 * np.sin(3.0 * T)


def write(path, content):
    """Write arrays in the format of the path; a dictionary in the content is a structure or a group."""
    if path.suffix == ".npz":
        np.savez(path, **content)
    elif path.suffix == ".mat":
        savemat(path, content)
    else:
        with h5py.File(path, "w") as file:
            for name, value in content.items():
                for key, inner in value.items() if isinstance(value, dict) else [(None, value)]:
                    file[name if key is None else f"{name}/{key}"] = inner
    return path


def mapping(time="t", angle="q", torque="u", **more):
    return {
        "time": {"column": time, "unit": "s"},
        "channels": {
            "torque": {"column": torque, "unit": "N m", "kind": "command"},
            "theta": {"column": angle, "unit": "rad", "kind": "measurement"},
        },
        **more,
    }


SUFFIXES = [".npz", ".mat", ".h5", ".hdf5"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_vectors_and_matrices_are_columns(tmp_path, suffix):
    content = {"t": T, "state": np.stack([ANGLE, SPEED], 1), "u": TORQUE, "mass": 0.7, "gains": np.ones(3)}
    path = write(tmp_path / f"log{suffix}", content)
    log = open_log(path)
    assert {"t", "state[0]", "state[1]", "u"} == set(log.tables[""].frame.columns)
    assert log.facts["mass"] == 0.7
    recording = read_log(path, mapping(angle="state[0]"))
    np.testing.assert_array_equal(recording.channels["theta"].value, ANGLE)
    np.testing.assert_array_equal(recording.channels["torque"].t, T)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_signals_along_rows_are_turned(tmp_path, suffix):
    content = {"t": T[None], "state": np.stack([ANGLE, SPEED]), "u": TORQUE[None]}
    path = write(tmp_path / f"log{suffix}", content)
    np.testing.assert_array_equal(read_log(path, mapping(angle="state[1]")).channels["theta"].value, SPEED)


@pytest.mark.parametrize(
    ("name", "value", "step"), [("Ts", 0.02, 0.02), ("fs", 50.0, 0.02), ("dt", 0.05, 0.05)]
)
def test_a_period_or_a_rate_makes_the_stamps(tmp_path, name, value, step):
    path = write(tmp_path / "log.mat", {"u": TORQUE, "q": ANGLE, name: value})
    recording = read_log(path, mapping(time="time"))
    np.testing.assert_allclose(recording.channels["theta"].t, step * np.arange(len(T)))
    assert any(f'the stamps follow from "{name}"' in note for note in recording.warnings)


def test_episodes_of_an_archive_are_runs(tmp_path):
    content = {
        "time": np.stack([T, T]),
        "q": np.stack([ANGLE, -ANGLE])[..., None],
        "u": np.stack([TORQUE, TORQUE]),
    }
    path = write(tmp_path / "log.npz", {**content, "goal": np.ones((2, 3))})
    first, second = read_logs(path, "torque_pendulum", mapping=mapping("time", "q"))
    np.testing.assert_array_equal(second.channels["theta"].value, -first.channels["theta"].value)
    assert open_log(path).tables[""].left_out.keys() == {"goal"}


@pytest.mark.parametrize("suffix", [".mat", ".h5"])
def test_groups_with_clocks_of_their_own_are_topics(tmp_path, suffix):
    content = {
        "motor": {"time": T[::2], "u": TORQUE[::2]},
        "encoder": {"time": T, "q": ANGLE},
    }
    path = write(tmp_path / f"log{suffix}", content)
    channels = {
        "torque": {"topic": "motor", "field": "u", "unit": "N m", "kind": "command"},
        "theta": {"topic": "encoder", "field": "q", "unit": "rad", "kind": "measurement"},
    }
    recording = read_log(path, {"channels": channels})
    assert (len(recording.channels["torque"]), len(recording.channels["theta"])) == (75, 150)


def test_elements_are_named_after_the_joints_of_the_file(tmp_path):
    content = {"time": T, "q": np.stack([ANGLE, SPEED], 1), "joint_names": np.array([b"hip", b"knee"])}
    path = write(tmp_path / "log.h5", content)
    assert {"q[hip]", "q[knee]"} < set(open_log(path).tables[""].frame.columns)


def test_objects_are_not_loaded(tmp_path):
    class Trap:
        def __reduce__(self):
            return (print, ("run",))

    path = tmp_path / "log.npz"
    np.savez(path, t=T, q=ANGLE, bad=np.array([Trap()], dtype=object))
    log = open_log(path)
    assert any("bad" in note for note in log.notes)


@pytest.mark.parametrize(
    ("suffix", "content", "message"),
    [
        (".npz", {"q": ANGLE, "u": TORQUE}, r"no array is a time .*; it has q, u; add the stamps"),
        (".mat", {"q": ANGLE, "Ts": -1.0}, "no array is a time"),
        (".h5", {"Ts": 0.1}, "no signals"),
    ],
)
def test_files_without_a_time_are_refused(tmp_path, suffix, content, message):
    with pytest.raises(LogError, match=message):
        open_log(write(tmp_path / f"log{suffix}", content))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_files_are_refused(tmp_path, suffix):
    path = write(tmp_path / f"log{suffix}", {"t": T, "q": ANGLE})
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(LogError, match="truncated or no"):
        open_log(path)

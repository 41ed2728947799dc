"""Archives of NumPy, files of MATLAB and HDF5 as logs."""

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from deepkoco.logs import LogError, read_log, read_logs
from deepkoco.logs.formats import open_log
from deepkoco.logs.formats.recordings import recordings

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
    ("name", "value", "step"),
    [
        ("Ts", 0.02, 0.02),
        ("fs", 50.0, 0.02),
        ("dt_ms", 5.0, 0.005),
        ("fs_khz", 1.0, 0.001),
        ("sample_time", 1.0, 1.0),
    ],
)
def test_a_period_or_a_rate_makes_the_stamps(tmp_path, name, value, step):
    path = write(tmp_path / "log.mat", {"u": TORQUE, "q": ANGLE, name: value})
    recording = read_log(path, mapping(time="time"), min_seconds=0.0)
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
    assert any("no time has as many samples: goal" in note for note in open_log(path).notes)


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


def test_the_period_of_an_excitation_is_none_of_the_samples(tmp_path):
    path = write(tmp_path / "log.npz", {"q": ANGLE, "u": TORQUE, "frequency": 0.5, "period": 2.0, "fs": 50.0})
    assert read_log(path, mapping(time="time")).channels["theta"].t[1] == pytest.approx(0.02)
    clash = write(tmp_path / "two.npz", {"q": ANGLE, "u": TORQUE, "dt": 0.5, "fs": 50.0})
    with pytest.raises(LogError, match=r'"fs" means a sample every 0\.02 s, "dt" every 0\.5 s'):
        open_log(clash)


def test_each_array_goes_to_the_clock_with_as_many_samples(tmp_path):
    path = write(
        tmp_path / "log.npz", {"t": T, "q": ANGLE, "u": TORQUE, "stamps": T[:60], "blob": np.ones(60)}
    )
    tables = open_log(path).tables
    assert {name: set(table.frame.columns) for name, table in tables.items()} == {
        "t": {"t", "q", "u"},
        "stamps": {"stamps", "blob"},
    }


def test_a_group_without_a_clock_takes_that_of_its_length(tmp_path):
    path = write(
        tmp_path / "log.h5", {"obs": {"timestamp": T, "q": ANGLE}, "action": {"u": TORQUE, "few": T[:70]}}
    )
    log = open_log(path)
    assert set(log.tables[""].frame.columns) == {"timestamp", "q", "action.u"}
    assert any("action.few" in note for note in log.notes)


def test_images_are_left_out_unread(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["q"] = T, ANGLE
        file.create_dataset("camera", shape=(20000, 480, 640, 3), dtype="u1", chunks=(1, 480, 640, 3))
    assert set(open_log(path).tables[""].frame.columns) == {"t", "q"}


def test_a_time_in_seconds_and_nanoseconds(tmp_path):
    stamp = np.stack([1_700_000_000 + np.floor(T), np.round(T % 1 * 1e9)], 1).astype(np.int64)
    path = write(tmp_path / "log.npz", {"stamp": stamp, "q": ANGLE, "u": TORQUE})
    np.testing.assert_allclose(read_log(path, mapping(time="stamp")).channels["theta"].t, T, atol=1e-6)


def test_a_wrench_has_no_joints(tmp_path):
    names = np.array([f"j{k}" for k in range(6)])
    content = {"t": T, "q": np.ones((150, 6)), "wrench": np.ones((150, 6)), "joint_names": names}
    columns = set(open_log(write(tmp_path / "log.npz", content)).tables[""].frame.columns)
    assert {"q[j0]", "wrench[0]"} < columns


def test_arrays_that_are_no_log_of_their_own_are_passed_over_in_a_folder(tmp_path):
    pd.DataFrame({"t": T, "u": TORQUE, "q": ANGLE}).to_csv(tmp_path / "log.csv", index=False)
    write(tmp_path / "log.npz", {"t": T, "u": TORQUE, "q": ANGLE})
    write(tmp_path / "calibration.npz", {"matrix": np.eye(6)})
    write(tmp_path / "other.mat", {"t": T, "u": TORQUE, "q": ANGLE})
    assert [path.name for path in recordings([tmp_path])] == ["log.csv", "other.mat"]


def test_a_folder_counts_a_file_by_names_in_groups_and_attributes(tmp_path):
    with h5py.File(tmp_path / "rate.h5", "w") as file:
        file["arm/q"] = ANGLE
        file["arm"].attrs["fs"] = 50.0
    with h5py.File(tmp_path / "weights.h5", "w") as file:
        file["layer/kernel"] = np.eye(3)
    assert [path.name for path in recordings([tmp_path])] == ["rate.h5"]

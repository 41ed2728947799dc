"""Faults that logs have in practice, each put into a clean log: into its numbers, its file or its sidecar."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from mcap.writer import Writer

Change = Callable[["DamagedLog", np.random.Generator], None]


@dataclass
class DamagedLog:
    """A log on its way into a file.

    Attributes:
        frame: columns t [s], torque, theta, omega in SI units.
        mapping: content of the sidecar.
        form: "csv", "parquet", "mcap", "bag" or "ros2".
        delimiter, decimal: of a CSV.
        rewrite: changes of the written bytes, in order.
        header: whether a CSV has its header row.
        fill: passed to the reader.
    """

    frame: pd.DataFrame
    mapping: dict[str, Any]
    form: str
    delimiter: str = ","
    decimal: str = "."
    rewrite: list[Callable[[bytes], bytes]] = field(default_factory=list)
    header: bool = True
    fill: str | None = None

    def rows(self, generator: np.random.Generator, most: int) -> slice:
        """A random stretch of at most so many rows."""
        length = int(generator.integers(1, most + 1))
        start = int(generator.integers(0, max(len(self.frame) - length, 1)))
        return slice(start, start + length)

    def channel(self, generator: np.random.Generator) -> str:
        """A random channel."""
        return str(generator.choice(["torque", "theta", "omega"]))

    def write(self, folder: Path) -> Path:
        """Write log and sidecar; the path of the log."""
        path = _WRITE[self.form](self, folder)
        for change in self.rewrite:
            target = (
                path if path.is_file() else next(f for f in sorted(path.iterdir()) if f.suffix != ".yaml")
            )
            target.write_bytes(change(target.read_bytes()))
        sidecar = path.with_name(f"{path.name}.yaml") if path.is_dir() else path.with_suffix(".yaml")
        sidecar.write_text(yaml.safe_dump(self.mapping, sort_keys=False))
        return path


def clean_mapping(system: str, command: str, unit: str, form: str) -> dict[str, Any]:
    """The right sidecar for a log of one joint as `DamagedLog` writes it."""
    units = {"torque": unit, "theta": "rad", "omega": "rad/s"}
    names = {"torque": command, "theta": "theta", "omega": "omega"}
    topics = form in ("mcap", "bag", "ros2")
    channels = {}
    for column, name in names.items():
        kind = "command" if column == "torque" else "measurement"
        field_of = {"torque": "effort", "theta": "position", "omega": "velocity"}[column]
        place = {"topic": "/joint", "field": field_of, "joint": "j"} if topics else {"column": column}
        channels[name] = {**place, "unit": units[column], "kind": kind}
    time = {} if topics else {"time": {"column": "t", "unit": "s"}}
    return {"system": system, **time, "channels": channels}


def _csv(log: DamagedLog, folder: Path) -> Path:
    path = folder / "log.csv"
    path.write_text(log.frame.to_csv(index=False, sep=log.delimiter, decimal=log.decimal, header=log.header))
    return path


def _parquet(log: DamagedLog, folder: Path) -> Path:
    path = folder / "log.parquet"
    frame = log.frame
    frame.astype({c: str for c in frame.columns if frame[c].dtype == object}).to_parquet(path)
    return path


def _mcap(log: DamagedLog, folder: Path) -> Path:
    import json

    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("joint", "jsonschema", b"{}")
        channel = writer.register_channel("/joint", "json", schema)
        for stamp, message in _messages(log):
            sec, nsec = divmod(stamp, 10**9)
            content = {"header": {"stamp": {"sec": sec, "nsec": nsec}}, "name": ["j"]}
            content |= {key: [None if not _finite(v) else v] for key, v in message.items()}
            writer.add_message(channel, stamp, json.dumps(content).encode(), stamp)
        writer.finish()
    return path


def _bag(log: DamagedLog, folder: Path) -> Path:
    from rosbags.rosbag1 import Writer as Bag
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    path = folder / "log.bag"
    with Bag(path) as bag:
        _fill(bag, store, store.serialize_ros1, log, {"seq": 0})
    return path


def _ros2(log: DamagedLog, folder: Path) -> Path:
    from rosbags.rosbag2 import Writer as Bag
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    path = folder / "log"
    with Bag(path, version=9) as bag:
        _fill(bag, store, store.serialize_cdr, log, {})
    return path


def _fill(bag: Any, store: Any, serialize: Callable, log: DamagedLog, header: dict[str, Any]) -> None:
    kind = "sensor_msgs/msg/JointState"
    connection = bag.add_connection("/joint", kind, typestore=store)
    time, head, state = (store.types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", kind))
    for stamp, message in _messages(log):
        sec, nsec = divmod(stamp, 10**9)
        values = {key: np.array([value], dtype=np.float64) for key, value in message.items()}
        content = state(
            header=head(stamp=time(sec=sec, nanosec=nsec), frame_id="", **header), name=["j"], **values
        )
        bag.write(connection, stamp, serialize(content, kind))


def _messages(log: DamagedLog):
    frame = log.frame
    if not {"t", "torque", "theta", "omega"} <= set(frame.columns):
        frame = frame.reindex(columns=["t", "torque", "theta", "omega"])
    frame = frame.loc[:, ~frame.columns.duplicated()]
    for row in frame.itertuples():
        values = {"position": row.theta, "velocity": row.omega, "effort": row.torque}
        t = row.t if _finite(row.t) and abs(float(row.t)) < 1e8 else 0.0
        yield 1_700_000_000 * 10**9 + round(float(t) * 1e9), {k: _number(v) for k, v in values.items()}


def _number(value: Any) -> float:
    return float(value) if _finite(value) else float("nan")


def _finite(value: Any) -> bool:
    try:
        return bool(np.isfinite(float(value)))
    except (TypeError, ValueError):
        return False


_WRITE: dict[str, Callable[[DamagedLog, Path], Path]] = {
    "csv": _csv,
    "parquet": _parquet,
    "mcap": _mcap,
    "bag": _bag,
    "ros2": _ros2,
}


def _none(log: DamagedLog, g: np.random.Generator) -> None:
    pass


def _gap(log: DamagedLog, g: np.random.Generator) -> None:
    part = log.rows(g, 200)
    log.frame = log.frame.drop(log.frame.index[part]).reset_index(drop=True)


def _lost_rows(log: DamagedLog, g: np.random.Generator) -> None:
    keep = g.random(len(log.frame)) > g.choice([0.01, 0.05, 0.2])
    log.frame = log.frame.iloc[np.flatnonzero(keep)].reset_index(drop=True)


def _repeated_rows(log: DamagedLog, g: np.random.Generator) -> None:
    again = np.sort(
        np.append(np.arange(len(log.frame)), g.integers(0, len(log.frame), int(g.integers(1, 30))))
    )
    log.frame = log.frame.iloc[again].reset_index(drop=True)


def _clock_reset(log: DamagedLog, g: np.random.Generator) -> None:
    at = int(g.integers(1, max(len(log.frame), 2)))
    t = log.frame["t"].to_numpy(dtype=float).copy()
    t[at:] += g.choice([-t[min(at, len(t) - 1)], -0.5, 0.7, 30.0, 86400.0])
    log.frame["t"] = t


def _swapped_stamps(log: DamagedLog, g: np.random.Generator) -> None:
    t = log.frame["t"].to_numpy(dtype=float).copy()
    part = log.rows(g, 20)
    t[part] = t[part][::-1]
    log.frame["t"] = t


def _nan_burst(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame.loc[log.frame.index[log.rows(g, 80)], log.channel(g)] = g.choice([np.nan, np.inf])


def _nan_sprinkle(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame.loc[g.random(len(log.frame)) < g.choice([0.005, 0.05, 0.3]), log.channel(g)] = np.nan


def _nan_stamps(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame.loc[log.frame.index[log.rows(g, 10)], "t"] = np.nan


def _constant(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame[log.channel(g)] = float(g.choice([0.0, 1.0, -3.7]))


def _frozen(log: DamagedLog, g: np.random.Generator) -> None:
    name, part = log.channel(g), log.rows(g, 600)
    log.frame.loc[log.frame.index[part], name] = log.frame[name].iloc[part.start]


def _one_sample(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame = log.frame.iloc[: int(g.integers(0, 3))].reset_index(drop=True)


def _short(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame = log.frame.iloc[: int(g.integers(3, 250))].reset_index(drop=True)


def _scaled(name: str, factors: tuple[float, ...]) -> Change:
    def change(log: DamagedLog, g: np.random.Generator) -> None:
        log.frame[name] = log.frame[name].astype(float) * g.choice(factors)

    return change


def _degrees(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame["theta"], log.frame["omega"] = np.degrees(log.frame["theta"]), np.degrees(log.frame["omega"])


def _huge(log: DamagedLog, g: np.random.Generator) -> None:
    rows = g.integers(0, max(len(log.frame), 1), int(g.integers(1, 6)))
    value = g.choice([1e3, 1e6, 1e15, 1e150, 1.7e308, -1e12])
    log.frame.loc[log.frame.index[rows[rows < len(log.frame)]], log.channel(g)] = value


def _swapped_columns(log: DamagedLog, g: np.random.Generator) -> None:
    a, b = (str(name) for name in g.choice(["torque", "theta", "omega"], 2, replace=False))
    log.frame = log.frame.rename(columns={a: b, b: a})


def _text_cells(log: DamagedLog, g: np.random.Generator) -> None:
    name = str(g.choice(["t", "torque", "theta", "omega"]))
    column = log.frame[name].astype(object)
    column.iloc[log.rows(g, 5)] = g.choice(["12 deg", "error", "1,5", "0x1F", "--", "True", "1e", "²"])
    log.frame[name] = column


def _missing_column(log: DamagedLog, g: np.random.Generator) -> None:
    log.frame = log.frame.drop(columns=str(g.choice(["t", "torque", "theta", "omega"])), errors="ignore")


def _same_name(log: DamagedLog, g: np.random.Generator) -> None:
    a, b = (str(name) for name in g.choice(log.frame.columns.to_numpy(), 2, replace=False))
    log.frame = log.frame.rename(columns={a: b}) if log.form == "csv" else log.frame.drop(columns=a)


def _no_header(log: DamagedLog, g: np.random.Generator) -> None:
    log.header = False


def _delimiter(log: DamagedLog, g: np.random.Generator) -> None:
    log.delimiter = str(g.choice([";", "\t", "|", " ", ":", "/"]))


def _decimal_comma(log: DamagedLog, g: np.random.Generator) -> None:
    log.decimal, log.delimiter = ",", str(g.choice([";", "\t", ","]))


def _cut(log: DamagedLog, g: np.random.Generator) -> None:
    share = float(g.random())
    log.rewrite.append(lambda raw: raw[: int(share * len(raw))])


def _flipped(log: DamagedLog, g: np.random.Generator) -> None:
    places, values = g.random(int(g.integers(1, 20))), g.integers(0, 256, 20).tolist()

    def change(raw: bytes) -> bytes:
        damaged = bytearray(raw)
        for place, value in zip(places, values, strict=False):
            if damaged:
                damaged[int(place * len(damaged))] = value
        return bytes(damaged)

    log.rewrite.append(change)


def _other_text(log: DamagedLog, g: np.random.Generator) -> None:
    junk = bytes(g.integers(128, 256, 12, dtype=np.uint8).tolist())
    log.rewrite.append(lambda raw: raw[:40] + junk + raw[40:])


def _nothing(log: DamagedLog, g: np.random.Generator) -> None:
    log.rewrite.append(lambda raw: b"")


def _sidecar(log: DamagedLog, g: np.random.Generator) -> None:
    mapping = log.mapping = copy.deepcopy(log.mapping)
    channel = mapping["channels"][str(g.choice(list(mapping["channels"])))]
    change = int(g.integers(0, 7))
    if change == 0:
        channel["unit"] = g.choice(["deg", "V", "furlong", "", "rad", "ms"]).item()
    elif change == 1:
        channel["kind"] = g.choice(["command", "measurement", "sensor"]).item()
    elif change == 2:
        channel[g.choice(["column", "field", "topic", "colour"]).item()] = "elsewhere"
    elif change == 3:
        mapping["time"] = {"column": "t", "unit": g.choice(["ms", "us", "m", "min"]).item()}
    elif change == 4:
        channel["scale"] = g.choice([0.0, -1.0, 57.3, 1e-3]).item()
    elif change == 5:
        mapping["where"] = {g.choice(["t", "run"]).item(): 0}
    else:
        mapping.pop(g.choice(["channels", "system"]).item())


def _fill_missing(log: DamagedLog, g: np.random.Generator) -> None:
    _nan_burst(log, g)
    log.fill = str(g.choice(["drop", "hold"]))


def _fill_sprinkle(log: DamagedLog, g: np.random.Generator) -> None:
    _nan_sprinkle(log, g)
    log.fill = str(g.choice(["drop", "hold"]))


FAULTS: dict[str, Change] = {
    "none": _none,
    "gap": _gap,
    "lost rows": _lost_rows,
    "repeated rows": _repeated_rows,
    "clock reset": _clock_reset,
    "stamps out of order": _swapped_stamps,
    "NaN burst": _nan_burst,
    "NaN here and there": _nan_sprinkle,
    "stamps missing": _nan_stamps,
    "NaN burst, filled": _fill_missing,
    "NaN here and there, filled": _fill_sprinkle,
    "constant channel": _constant,
    "frozen channel": _frozen,
    "no or one sample": _one_sample,
    "short": _short,
    "time in other unit": _scaled("t", (1e3, 1e-3, 1e6, 1 / 60)),
    "angle in other unit": _scaled("theta", (57.29577951, 1e3, 1 / 6.283185307, -1.0)),
    "speed in other unit": _scaled("omega", (57.29577951, 9.549296586, 1 / 6.283185307, -1.0)),
    "angle and speed in degrees": _degrees,
    "command in other unit": _scaled("torque", (1e3, 1e-3, 100.0)),
    "huge values": _huge,
    "columns swapped": _swapped_columns,
    "text in cells": _text_cells,
    "column missing": _missing_column,
    "two columns of one name": _same_name,
    "no header": _no_header,
    "wrong delimiter": _delimiter,
    "decimal comma": _decimal_comma,
    "cut off": _cut,
    "bytes changed": _flipped,
    "not UTF-8": _other_text,
    "empty file": _nothing,
    "wrong sidecar": _sidecar,
}
FORMS = tuple(_WRITE)

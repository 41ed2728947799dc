"""A node that raises, hangs or dies stops the graph: one error that names it, and all others are closed."""

import os
import queue
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from live_nodes import AMPLE, BigDevice, QuietDevice, act, devices

from deepkoco.graph import Graph, read_episodes, replay_timing
from deepkoco.graph.live import ConcurrentRuntime, NodeFailure, WallClockRuntime
from deepkoco.graph.live.clocked import clocked_schedule
from deepkoco.graph.live.inbox import Order
from deepkoco.graph.live.seat import Seat
from tests.on_time import on_time

RUNTIMES = {
    "threads": lambda graph, limit=AMPLE: ConcurrentRuntime(graph, time_limit=limit),
    "processes": lambda graph, limit=AMPLE: ConcurrentRuntime(
        graph, processes={"motor": 1}, time_limit=limit, beat_limit=AMPLE
    ),
    "one process": lambda graph, limit=AMPLE: ConcurrentRuntime(
        graph, processes={"motor": 1, "camera": 1}, time_limit=limit, beat_limit=AMPLE
    ),
    "wall clock": lambda graph, limit=AMPLE: WallClockRuntime(graph, time_limit=limit, beat_limit=AMPLE),
}
REASONS = {
    "raise": "ValueError: encoder cable is off",
    "hang": "has not returned for 0.5 s",
    "nan": r"NotFiniteError: output entry \[1\] is nan; a node that says so on purpose has the class attribute .*",
    "sleep": "has not returned for 0.5 s",
    "die": "its process has died \\(exit status -9\\)",
}
CASES = [
    (runtime, fault)
    for runtime in RUNTIMES
    for fault in REASONS
    if not (runtime == "threads" and fault == "die") and (fault != "sleep" or runtime == "wall clock")
]


@pytest.mark.parametrize(("kind", "fault"), CASES)
@on_time
def test_a_failing_node_stops_the_graph_within_100_ms(tmp_path, kind, fault):
    graph = devices(tmp_path, fault)
    runtime = RUNTIMES[kind](graph, 0.5 if fault in ("hang", "sleep") else AMPLE)
    runtime.reset({}, torch.Generator())
    message = f'node "motor" at its tick 3: {REASONS[fault]}; the graph is stopped'
    with pytest.raises(NodeFailure, match=message) as caught:
        runtime.run(act, 1000)
    failure = caught.value
    assert (failure.node, failure.tick) == ("motor", 3)
    # A process that was killed takes its nodes with it; all others are closed, once.
    gone = {"motor", "camera"} if (kind, fault) == ("one process", "die") else {"motor"}
    closed = {"motor", "camera"} - (gone if fault == "die" else set())
    assert set(failure.closed_after) == closed
    assert max(failure.closed_after.values(), default=0.0) < 0.1
    for name in closed:
        assert len(graph.node(name).marks("close")) == 1
    if fault == "raise":
        assert "raise_error" in failure.details
        assert failure.__notes__ == [failure.details]


@on_time
def test_a_step_that_holds_the_interpreter_lock_stops_the_policy_before_the_process_has_ended(tmp_path):
    graph = devices(tmp_path, "compute")
    runtime = WallClockRuntime(graph, time_limit=0.3)
    frozen: list[float] = []  # when the policy saw the last output before the step that does not return

    def policy(inputs):
        if int(inputs["motor"].seq[0, -1]) == 2:
            frozen.append(time.monotonic())
        return act(inputs)

    runtime.reset({}, torch.Generator())
    with pytest.raises(NodeFailure, match=r'node "motor" at its tick 3: has not returned for 0\.3 s'):
        runtime.run(policy, 1000)
    assert frozen[-1] - frozen[0] < 0.8  # the step itself takes more than a second
    runtime.close()  # once is enough: `run` has raised it


@on_time
def test_close_raises_a_failure_that_no_step_has_raised(tmp_path):
    graph = devices(tmp_path, "compute")
    runtime = WallClockRuntime(graph, time_limit=0.3)
    state, inputs = runtime.reset({}, torch.Generator())
    while int(inputs["motor"].seq[0, -1]) < 2:
        state, inputs = runtime.step(state, act(inputs))
    time.sleep(0.8)  # the step itself takes more than a second
    with pytest.raises(NodeFailure, match='node "motor" at its tick 3'):
        runtime.close()
    runtime.close()


@on_time
def test_a_seat_fails_by_itself_when_a_step_comes_back_late(tmp_path):
    graph = devices(tmp_path, "nap")
    motor, replies = graph.node("motor"), queue.SimpleQueue()
    inputs = graph.inputs_of("motor")
    seat = Seat(
        0,
        lambda: motor,
        "motor",
        inputs,
        {2: 0},
        [],
        np.zeros((1, 4), np.int64),
        lambda *r: replies.put(r),
        0.1,
    )
    seat.start()
    values = {
        "episode": 0,
        "generator": torch.Generator().get_state().numpy(),
        "parameters": {},
        "initial": {},
    }
    seat.inbox.order(Order("reset", values))
    action = torch.zeros(1, 2, dtype=torch.float64)
    part = {"part": clocked_schedule(graph, "motor", False, 0), "initial_outputs": [action.numpy()]}
    seat.inbox.order(Order("go", part | {"origin": time.monotonic_ns(), "factor": 1.0, "record": True}))
    said = [replies.get(timeout=10) for _ in range(4)]
    assert [kind for _, kind, _ in said] == ["opened", "reset", "failed", "closed"]
    assert (said[2][2].node, said[2][2].tick) == ("motor", 3)
    assert re.fullmatch(r"has returned after 0\.\d+ s, and may take 0\.1 s", said[2][2].reason)
    assert len(seat.driver.log()["outputs"]) == 3  # the late output goes nowhere


@pytest.mark.parametrize("kind", RUNTIMES)
def test_an_action_that_is_not_finite_stops_the_graph_and_is_not_sent(tmp_path, kind):
    graph = devices(tmp_path)
    runtime = RUNTIMES[kind](graph)
    state, _ = runtime.reset({}, torch.Generator())
    state, _ = runtime.step(state, torch.ones(1, 2, dtype=torch.float64))
    with pytest.raises(
        NodeFailure, match=r'node "agent" at its tick 1: NotFiniteError: action entry \[0\] is -inf'
    ):
        runtime.step(state, torch.tensor([[-torch.inf, 0.0]], dtype=torch.float64))
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]
    assert np.isfinite(runtime.finish().outputs["agent"]).all()


@pytest.mark.parametrize("kind", RUNTIMES)
def test_a_node_that_declares_so_may_put_out_nan(tmp_path, kind):
    healthy = devices(tmp_path)
    nodes = [QuietDevice("motor", 50, tmp_path, "nan"), healthy.node("camera"), healthy.node("agent")]
    seen = []

    def policy(inputs):
        seen.append(bool(inputs["motor"].data.isnan().any()))
        return torch.zeros(1, 2, dtype=torch.float64)

    with RUNTIMES[kind](Graph(nodes, healthy.connections)) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(policy, 8)
    assert any(seen)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_a_node_that_closes_slowly_is_waited_for(tmp_path, kind):
    graph = devices(tmp_path, "slow close")
    with RUNTIMES[kind](graph) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(act, 2)
    assert len(graph.node("motor").marks("close")) == 1


@pytest.mark.parametrize("kind", ["processes", "wall clock"])
def test_what_ran_until_a_failure_is_kept(tmp_path, kind):
    graph = devices(tmp_path, "raise", at=12)
    runtime = RUNTIMES[kind](graph)
    runtime.reset({}, torch.Generator())
    with pytest.raises(NodeFailure):
        runtime.run(act, 1000)
    episode = runtime.finish()
    motor = episode.outputs["motor"]
    assert 10 <= len(motor) <= 12
    assert motor[:, 0].tolist() == [k * (k + 1) / 2 for k in range(1, len(motor) + 1)]
    timing = replay_timing(graph, episode.measured)
    for edge, connection in enumerate(graph.connections):
        np.testing.assert_array_equal(timing.windows_of(edge), episode.windows[connection.key])


def test_a_record_that_died_with_its_process_is_missed_by_name(tmp_path):
    runtime = RUNTIMES["processes"](devices(tmp_path, "die"))
    runtime.reset({}, torch.Generator())
    with pytest.raises(NodeFailure):
        runtime.run(act, 1000)
    with pytest.raises(ValueError, match='the record of "motor" is lost with its process'):
        runtime.finish()


@on_time
def test_a_process_that_stands_still_is_noticed_by_its_heartbeat(tmp_path):
    graph = devices(tmp_path)
    with WallClockRuntime(graph, time_limit=30.0, beat_limit=1.0) as runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(act, 2)
        os.kill(int(graph.node("motor").marks("open")[0].split()[0]), signal.SIGSTOP)
        with pytest.raises(NodeFailure, match=r'node "motor".*shows no life for 1 s') as caught:
            runtime.run(act, 1000)
        assert set(caught.value.closed_after) == {"camera"}


@on_time
def test_a_process_that_stands_still_in_the_middle_of_a_message_is_noticed(tmp_path):
    healthy = devices(tmp_path)
    camera = BigDevice("camera", 100, tmp_path)
    graph = Graph([healthy.node("motor"), camera, healthy.node("agent")], healthy.connections)
    runtime = WallClockRuntime(graph, time_limit=30.0, beat_limit=1.0, record=False)
    runtime.reset({}, torch.Generator())
    os.kill(int(camera.marks("open")[0].split()[0]), signal.SIGSTOP)
    with pytest.raises(NodeFailure, match=r'node "camera".*shows no life for 1 s'):
        runtime.run(lambda inputs: torch.zeros(1, 2, dtype=torch.float64), 1000)


def test_a_policy_that_raises_closes_the_nodes(tmp_path):
    graph = devices(tmp_path)
    runtime = ConcurrentRuntime(graph, processes={"motor": 1}, beat_limit=AMPLE)

    def policy(inputs):
        raise ZeroDivisionError("no gain")

    runtime.reset({}, torch.Generator())
    with pytest.raises(ZeroDivisionError):
        runtime.run(policy, 3)
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]
    with pytest.raises(ValueError, match="reset first"):
        runtime.run(act, 1)
    # A reset starts anew.
    with runtime:
        runtime.reset({}, torch.Generator())
        runtime.run(act, 2)
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [2, 2]


def test_a_close_that_raises_is_reported_and_does_not_keep_the_others_from_closing(tmp_path):
    graph = devices(tmp_path, "bad close")
    runtime = ConcurrentRuntime(graph, processes={"motor": 1}, beat_limit=AMPLE)
    runtime.reset({}, torch.Generator())
    runtime.run(act, 2)
    with pytest.raises(NodeFailure, match=r'node "motor".*close raised OSError: the drive does not answer'):
        runtime.close()
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]


def test_ctrl_c_closes_the_nodes_and_leaves_the_record(tmp_path):
    graph = devices(tmp_path)
    runtime = WallClockRuntime(graph, time_limit=AMPLE, beat_limit=AMPLE)
    runtime.reset({}, torch.Generator())

    def policy(inputs):
        if int(inputs["motor"].seq[0, -1]) >= 5:
            # As a terminal does it: Ctrl-C reaches the processes of the nodes first, which leave it to the caller.
            for name in ("motor", "camera"):
                os.kill(int(graph.node(name).marks("open")[0].split()[0]), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
        return act(inputs)

    with pytest.raises(KeyboardInterrupt):
        runtime.run(policy, 1000)
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]
    assert len(runtime.finish().outputs["motor"]) >= 5


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_process_that_is_told_to_end_closes_its_nodes(tmp_path, name):
    number = getattr(signal, name, None)
    if number is None or signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip(f"{name} does not exist here, or is ignored")
    graph = devices(tmp_path)
    runtime = ConcurrentRuntime(graph, processes={"motor": 1}, beat_limit=AMPLE)
    runtime.reset({}, torch.Generator())
    os.kill(int(graph.node("motor").marks("open")[0].split()[0]), number)
    with pytest.raises(NodeFailure, match=r'node "motor".*its process has died \(exit status 0\)'):
        runtime.run(act, 1_000_000)
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]


SCRIPT = """
    import sys
    sys.path[:0] = {paths!r}
    import torch
    from live_nodes import AMPLE, act, devices
    from deepkoco.graph.live import ConcurrentRuntime
    if __name__ == "__main__":
        options = {{"processes": {{"motor": 1, "camera": 1}}, "real_time_factor": 1.0, "beat_limit": AMPLE}}
        with ConcurrentRuntime(devices({folder!r}), **options) as runtime:
            runtime.reset({{}}, torch.Generator())
            print("runs", flush=True)
            runtime.run(act, 100000)
"""
FORGETFUL = """
    import sys
    sys.path[:0] = {paths!r}
    import torch
    from live_nodes import AMPLE, act, devices
    from deepkoco.graph.live import ConcurrentRuntime
    if __name__ == "__main__":
        options = {{"processes": {{"motor": 1}}, "beat_limit": AMPLE, "record": {folder!r} + "/run.mcap"}}
        runtime = ConcurrentRuntime(devices({folder!r}), **options)
        runtime.reset({{}}, torch.Generator())
        runtime.run(act, 3)
"""


def start(text: str, folder: Path) -> subprocess.Popen[str]:
    here = Path(__file__).parent
    script = folder / "script.py"
    script.write_text(textwrap.dedent(text.format(paths=[str(here), str(here.parent)], folder=str(folder))))
    environment = {**os.environ, "PYTHONPATH": str(here.parents[2]), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, str(script)], env=environment, stdout=subprocess.PIPE, text=True)


def test_a_script_that_ends_without_closing_leaves_the_nodes_closed_and_the_recording_whole(tmp_path):
    caller = start(FORGETFUL, tmp_path)
    caller.communicate(timeout=200)
    assert caller.returncode == 0
    assert read_episodes(tmp_path / "run.mcap").complete
    graph = devices(tmp_path)
    assert [len(graph.node(name).marks("close")) for name in ("motor", "camera")] == [1, 1]


def test_a_killed_caller_leaves_the_nodes_closed(tmp_path):
    caller = start(SCRIPT, tmp_path)
    assert caller.stdout is not None
    assert caller.stdout.readline() == "runs\n"
    caller.kill()
    caller.wait()
    caller.stdout.close()
    graph = devices(tmp_path)
    deadline = time.monotonic() + 120  # as long as it takes: what counts is that they are closed
    marks: list[int] = []
    while marks != [1, 1] and time.monotonic() < deadline:
        marks = [len(graph.node(name).marks("close")) for name in ("motor", "camera")]
        time.sleep(0.01)
    assert marks == [1, 1]

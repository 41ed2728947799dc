"""What a diagnosis says while it runs, where stderr is a file."""

import time

import pytest

from deepkoco.cli.diagnose import _Doing


@pytest.mark.parametrize(("quiet", "every", "wanted"), [(False, 0.0, 2), (False, 60.0, 0), (True, 0.0, 0)])
def test_steps_are_lines_in_a_file(capsys, quiet, every, wanted):
    with _Doing(quiet, every) as say:
        say("reading the logs")
        say("fitting the initial states")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == wanted
    assert [line.split("s  ")[1] for line in lines] == ["reading the logs", "fitting the initial states"][
        :wanted
    ]


def test_a_step_that_begins_soon_after_a_line_is_written_once_it_takes_long(capsys):
    doing = _Doing(False, 2.0)
    with doing as say:
        doing.said -= 10.0
        say("search")
        say("a short step")
        say("refit")
        shown, deadline = "", time.monotonic() + 20.0
        while "refit" not in shown and time.monotonic() < deadline:
            time.sleep(0.05)
            shown += capsys.readouterr().err
    assert [line.split("s  ")[1] for line in shown.splitlines()] == ["search", "refit"]


def test_a_step_in_which_the_work_ends_is_not_written_later():
    doing = _Doing(False, 60.0)
    with doing as say:
        say("drawing the report")
        assert not doing.later.finished.is_set()
    assert doing.later.finished.is_set()

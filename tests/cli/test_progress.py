"""What a diagnosis says while it runs, where stderr is a file."""

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

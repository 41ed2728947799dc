"""What a wheel holds: everything that a user outside a checkout needs, and nothing of the studies."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# What `pip wheel` copies, as setuptools lists it; nothing is built, and nothing is written into the checkout.
LIST = """
import json, sys
from distutils.core import run_setup
distribution = run_setup("setup.py", stop_after="init")
distribution.parse_config_files()
distribution.get_command_obj("egg_info").egg_base = sys.argv[1]
build = distribution.get_command_obj("build_py")
build.build_lib = "LIB"
build.ensure_finalized()
print(json.dumps(build.get_outputs(include_bytecode=False)))
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> set[str]:
    """Paths inside the wheel."""
    code = "import setuptools\n" + LIST
    listed = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path_factory.mktemp("egg"))],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return {str(Path(path).relative_to("LIB")) for path in json.loads(listed.stdout.splitlines()[-1])}


def below(folder: str, *endings: str) -> set[str]:
    """Files of a folder of the checkout."""
    return {
        str(path.relative_to(ROOT))
        for path in (ROOT / folder).rglob("*")
        if path.suffix in endings and "__pycache__" not in path.parts
    }


def test_every_file_of_settings_is_in_the_package(files):
    expected = {f"deepkoco/{path}" for path in below("configs", ".yaml")}
    assert len(expected) > 50
    assert expected <= files


def test_every_module_page_header_and_style_is_in_the_wheel(files):
    expected = below("deepkoco", ".py", ".html", ".h", ".mplstyle", ".typed") | {"deepkoco/py.typed"}
    assert len(expected) > 300
    assert expected <= files


def test_the_baselines_and_the_sweeper_that_hydra_looks_for_are_in_the_wheel(files):
    assert below("baselines", ".py") <= files
    assert "hydra_plugins/reporting_sweeper.py" in files


def test_studies_and_tests_stay_out_of_the_wheel(files):
    assert {path.split("/")[0] for path in files} == {"deepkoco", "baselines", "hydra_plugins"}

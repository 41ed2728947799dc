"""The setup of a graph: what of it can change without its code, as one YAML file."""

from deepkoco.graph.setup.apply import apply_parameters, apply_setup
from deepkoco.graph.setup.describe import describe_setup
from deepkoco.graph.setup.file import SetupError, read_setup, write_setup

__all__ = ["SetupError", "apply_parameters", "apply_setup", "describe_setup", "read_setup", "write_setup"]

"""Design of experiments that tell causes apart."""

from deepkoco.diagnose.design.design import Design, InseparableError, design_experiment
from deepkoco.diagnose.design.design_files import write_design
from deepkoco.diagnose.design.stage import DesignError

__all__ = ["Design", "DesignError", "InseparableError", "design_experiment", "write_design"]

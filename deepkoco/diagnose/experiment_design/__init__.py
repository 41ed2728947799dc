"""Design of experiments that distinguish causes."""

from deepkoco.diagnose.experiment_design.design import Design, InseparableError, design_experiment
from deepkoco.diagnose.experiment_design.design_files import write_design
from deepkoco.diagnose.experiment_design.experiment_setup import DesignError

__all__ = ["Design", "DesignError", "InseparableError", "design_experiment", "write_design"]

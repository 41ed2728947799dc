"""`python -m experiments.evaluate` is `deepkoco evaluate`, for the commands that recorded results name."""

from deepkoco.runs.evaluate import evaluate
from deepkoco.runs.hydra_command import run_command

if __name__ == "__main__":
    run_command("evaluate", evaluate)

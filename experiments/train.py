"""`python -m experiments.train` is `deepkoco train`, for the commands that recorded results name."""

from deepkoco.runs.hydra_command import run_command
from deepkoco.runs.train import train

if __name__ == "__main__":
    run_command("train", train)

"""`python -m experiments.unit_trials` is `deepkoco trial`, for the commands that recorded results name."""

import sys

from deepkoco.cli.command_line import main

if __name__ == "__main__":
    sys.exit(main(["trial", *sys.argv[1:]]))

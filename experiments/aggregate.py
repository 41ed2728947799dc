"""`python -m experiments.aggregate` is `deepkoco aggregate`, for the commands that recorded results name."""

import sys

from deepkoco.cli import main

if __name__ == "__main__":
    sys.exit(main(["aggregate", *sys.argv[1:]]))

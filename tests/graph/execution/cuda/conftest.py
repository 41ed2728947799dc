"""Tests of the CUDA executor share helpers with those of the runtimes."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # timing_reference

"""Kernels of these tests live in the folder of the other kernels' tests; helpers lie beside those."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # compiled

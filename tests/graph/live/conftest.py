"""Makes the graphs and the oracle of the folder above importable, in the processes of nodes as well."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

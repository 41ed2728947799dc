"""Makes the graphs and nodes of the folders beside this one importable, in the processes of nodes as well."""

import sys
from pathlib import Path

for folder in (Path(__file__).parents[1], Path(__file__).parents[1] / "live"):
    sys.path.insert(0, str(folder))

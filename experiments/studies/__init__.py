"""Studies, whose results are under results/."""

"""The main job from end to end, on one page: `python -m experiments.demo`."""

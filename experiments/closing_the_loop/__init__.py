"""What a diagnosis is worth in control: `python -m experiments.closing_the_loop`."""

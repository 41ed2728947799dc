"""What a diagnosis is worth in control: `python -m experiments.studies.diagnosis.closing_the_loop`."""

"""From selected causes to a verdict: named, ambiguous, unknown or nothing."""

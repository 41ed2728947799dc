"""Commands of lost rows, fitted as states of their windows."""

"""Simulation of any system's equations as bytecode: traced once, then run over all windows and lanes at once."""

"""Probabilities of causes from one likelihood with model error, one hierarchical prior and one evidence.

`docs/diagnose_probability.md` has the mathematics. The diagnosis runs this method beside its own and reports the answer
under `evidence`; it decides nothing yet.
"""

"""Probabilities of causes from one likelihood with model error, one hierarchical prior and one evidence.

`docs/diagnose_probability.md` has the mathematics. The diagnosis weighs the explanations of model files by this method
(`diagnose/weighed.py`), and on request reports its answer under `evidence`.
"""

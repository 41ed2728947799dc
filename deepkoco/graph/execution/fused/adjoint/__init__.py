"""Gradients of the fused executor: a reverse kernel, generated from the traces of the nodes beside the forward one."""

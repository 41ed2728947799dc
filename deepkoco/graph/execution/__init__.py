"""Running the node functions of a graph over its computation graph, for a batch of environments."""

"""What a robot is as a graph: nodes, connections, and the contract that they keep."""

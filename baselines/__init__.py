"""Published agents to compare DeepKoCo with: SAC, SAC with a shared encoder, DeepMDP and DBC."""

"""A grid of agents, tasks, distractors and seeds: trained, resumed and put into one table."""

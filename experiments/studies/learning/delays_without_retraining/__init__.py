"""Study: one policy, trained without delays, among delays of its observations and commands; rivals are retrained."""

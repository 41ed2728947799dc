"""Episodes: what happened in a run, kept in memory and on disk."""

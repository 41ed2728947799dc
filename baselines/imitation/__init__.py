"""Interactive imitation: an ensemble learns from answers of a teacher, and asks where its members disagree."""

"""Study of a pendulum that is identified from pictures of it."""

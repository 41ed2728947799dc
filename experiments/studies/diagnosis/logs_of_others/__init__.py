"""Studies of published logs as a user would write them: a class or an MJCF, and a YAML file."""

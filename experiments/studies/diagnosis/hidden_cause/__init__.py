"""HiddenCause: a benchmark of diagnosis. Units with one hidden cause, and several methods on the same cases."""

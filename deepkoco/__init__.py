"""DeepKoCo: delay-graph simulation, deep Koopman control, identification and diagnosis."""

__version__ = "0.1.0"

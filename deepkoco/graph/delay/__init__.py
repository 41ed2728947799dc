"""Delay laws: how long a computation or a message takes, and what ties one delay to another."""

from deepkoco.graph.delay.correlated import Autoregressive, OrnsteinUhlenbeck, OverrunProcess
from deepkoco.graph.delay.law import (
    LAWS,
    Delay,
    DelayError,
    Stream,
    exact_fraction,
    exact_seconds,
    make_delay,
)
from deepkoco.graph.delay.lossy import Lossy
from deepkoco.graph.delay.mixture import Empirical, Mixture
from deepkoco.graph.delay.rank import RankCorrelation, make_correlation
from deepkoco.graph.delay.recorded import RecordedDelays
from deepkoco.graph.delay.scheduled import Scheduled, transport_delay
from deepkoco.graph.delay.simple import Deterministic, Gamma, Gaussian, LogNormal, Uniform
from deepkoco.graph.delay.stalls import Stalls, make_stalls

__all__ = [
    "LAWS",
    "Autoregressive",
    "Delay",
    "DelayError",
    "Deterministic",
    "Empirical",
    "Gamma",
    "Gaussian",
    "LogNormal",
    "Lossy",
    "Mixture",
    "OrnsteinUhlenbeck",
    "OverrunProcess",
    "RankCorrelation",
    "RecordedDelays",
    "Scheduled",
    "Stalls",
    "Stream",
    "Uniform",
    "exact_fraction",
    "exact_seconds",
    "make_correlation",
    "make_delay",
    "make_stalls",
    "transport_delay",
]

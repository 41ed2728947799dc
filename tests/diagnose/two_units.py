"""A log of two units, one after the other."""

from dataclasses import replace

import numpy as np

from deepkoco.logs.recording import Recording


def joined(first: Recording, second: Recording, at: float) -> Recording:
    """Return one log until a time [s], and then the other one from its begin, as one recording."""
    channels = {}
    for name, a in first.channels.items():
        b = second.channels[name]
        kept = a.t < at
        t, value = np.append(a.t[kept], b.t + at), np.append(a.value[kept], b.value)
        channels[name] = replace(a, t=t, value=value)
    return Recording(channels, system=first.system)

"""Engines in whose steps a robot can be simulated along logs, by name."""

from __future__ import annotations

MUJOCO = "MuJoCo"
"""Friction creeps, and steps are those of the integrator that a model file chooses."""

SEMI_IMPLICIT = "semi-implicit"
"""Rigid bodies in semi-implicit steps v' = v + h a(q, v), q' = q + h v', in which dry friction holds, as in Bullet."""

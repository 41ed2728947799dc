"""Gymnasium ids of the environments; importing deepkoco.envs registers them."""

from __future__ import annotations

import gymnasium

# id -> (steps of an episode, arguments). A new environment is one line.
ENVIRONMENTS: dict[str, tuple[int, dict]] = {
    # Gymnasium's Pendulum-v1: without delays and at 20 Hz its own integrator, step by step.
    "deepkoco/RodPendulum-v0": (
        200,
        {"system": "rod_pendulum", "world_rate": 20.0, "integrator": "semi_implicit_euler"},
    ),
    # The same task on continuous physics, for delays and for models of a unit.
    "deepkoco/RodPendulumDelay-v0": (200, {"system": "rod_pendulum"}),
    "deepkoco/Pendulum-v0": (250, {"system": "pendulum", "world_rate": 200.0}),
    "deepkoco/TorquePendulum-v0": (250, {"system": "torque_pendulum", "world_rate": 200.0}),
    # The tip of a two-link arm tracks a target on a circle; the second has a target at rest.
    "deepkoco/Manipulator-v0": (200, {"system": "two_link_arm", "task": "manipulator"}),
    "deepkoco/ManipulatorFixedTarget-v0": (200, {"system": "two_link_arm", "task": "manipulator_fixed"}),
    # A quadrotor follows a circle of a drawn radius; its own lags and delays are part of the system.
    "deepkoco/QuadrotorCircle-v0": (250, {"system": "quadrotor", "task": "quadrotor_circle"}),
}

# A robot and a task of one's own: `deepkoco train --system arm.xml --task my_task.py:Swing`, see docs/own_robot.md.
ROBOT = "deepkoco/Robot-v0"
ENVIRONMENTS[ROBOT] = (200, {"world_rate": None})

# A pool whose thermometer sits behind a pipe: the delay depends on the pump, which is an action.
POOL, POOL_STEPS = "deepkoco/Pool-v0", 200

# A quadrotor lands on an inclined deck that moves: 0 to 25 degrees, 0 to 1 m/s.
LANDING, LANDING_STEPS = "deepkoco/InclinedLanding-v0", 200

# An arm with six joints pushes a box to a goal, in MuJoCo; the box is seen late, and its friction varies.
BOX_PUSH, BOX_PUSH_STEPS = "deepkoco/BoxPush-v0", 100

# A unit in virtual time, for policies that learn on it: task.id=deepkoco/Unit-v0 +task.kwargs.unit=UNIT.yaml
UNIT, UNIT_STEPS = "deepkoco/Unit-v0", 200

# Ten seconds of a task of the DeepMind Control Suite, decided every 0.04 s; it needs the extra dm_control.
DM_CONTROL = "deepkoco/DmControl-v0"
DM_CONTROL_STEPS = 250


def register_envs() -> None:
    """Register every id with Gymnasium; does nothing for one that is there already."""
    for name, (steps, arguments) in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="deepkoco.envs.delay_env:DelayGraphEnv",
                vector_entry_point="deepkoco.envs.delay_env:DelayGraphVectorEnv",
                max_episode_steps=steps,
                kwargs=arguments,
            )
    for name, steps, kind in (
        (POOL, POOL_STEPS, "pool.pool_env:Pool"),
        (LANDING, LANDING_STEPS, "landing.landing_env:Landing"),
        (BOX_PUSH, BOX_PUSH_STEPS, "boxpush.boxpush_env:BoxPush"),
    ):
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"deepkoco.envs.{kind}Env",
                vector_entry_point=f"deepkoco.envs.{kind}VectorEnv",
                max_episode_steps=steps,
            )
    if UNIT not in gymnasium.registry:
        # Not in wall-clock time: environments that are stepped one after the other would miss their ticks.
        gymnasium.register(
            UNIT,
            entry_point="deepkoco.envs.unit_env:UnitEnv",
            max_episode_steps=UNIT_STEPS,
            kwargs={"clock": "simulated"},
        )
    if DM_CONTROL not in gymnasium.registry:
        gymnasium.register(
            DM_CONTROL,
            entry_point="deepkoco.envs.dm_control:make_dm_control",
            max_episode_steps=DM_CONTROL_STEPS,
        )

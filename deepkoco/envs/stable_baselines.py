"""A vector environment for stable-baselines3, which takes environments of its own kind only; needs that package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingImports]

from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.settings import SettingsError


class StableBaselinesEnv(VecEnv):
    """Environments that step together, behind the interface `VecEnv` of stable-baselines3.

    All B environments advance in one call, so 64 of them cost little more than one:

        envs = deepkoco.make_env("arm.xml", num_envs=64, autoreset_mode="SameStep")
        PPO("MlpPolicy", StableBaselinesEnv(envs)).learn(100_000)

    Args:
        envs: Made with ``autoreset_mode="SameStep"``, as stable-baselines3 expects.

    Raises:
        SettingsError: They start anew in another way.
    """

    def __init__(self, envs: GraphVectorEnv) -> None:
        mode = envs.metadata["autoreset_mode"]
        if mode != AutoresetMode.SAME_STEP:
            raise SettingsError(
                f'autoreset_mode = "{mode.value}"; stable-baselines3 needs make_env(..., autoreset_mode="SameStep")'
            )
        self.envs = envs
        self.render_mode = getattr(envs, "render_mode", None)
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions = np.zeros(envs.action_space.shape or ())

    def reset(self) -> np.ndarray:
        """Start new episodes, with the seeds given to `seed` before."""
        given = [seed for seed in self._seeds if seed is not None]
        observation, info = self.envs.reset(seed=list(self._seeds) if given else None)
        self.reset_infos = [_of(info, i) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (B, ...) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observations (B, ...), rewards (B,), ends (B,), and a dict for each environment.

        Of an environment that has ended, the dict holds its last observation, and whether only the time was up.
        """
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        ended = terminated | truncated
        infos = [_of(info, i) for i in range(self.num_envs)]
        for i in np.flatnonzero(ended):
            infos[i]["terminal_observation"] = info["final_obs"][i]
            infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observation, reward.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of the vector environment, once for each of the environments."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible for a single environment.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError(
            "environments that step together share their attributes; set that of `envs`"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Not possible for a single environment.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError("environments that step together share their methods; call that of `envs`")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No environment has a wrapper of its own."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Pictures of all environments."""
        pictures = self.envs.render()
        return [None] * self.num_envs if pictures is None else list(pictures)


def _of(info: dict[str, Any], index: int) -> dict[str, Any]:
    """What Gymnasium's info of a vector environment says of one of them."""
    return {
        name: value[index]
        for name, value in info.items()
        if not name.startswith(("_", "final_")) and bool(info.get(f"_{name}", (True,) * (index + 1))[index])
    }

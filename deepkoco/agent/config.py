"""Hyper-parameters of DeepKoCo's training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from deepkoco.agent.action_value import ActionValueConfig
from deepkoco.agent.exploration import NOISE_UNITS
from deepkoco.agent.kept_weights import KEPT
from deepkoco.koopman.model.model import ModelConfig
from deepkoco.koopman.model.rollout import ROLLOUTS
from deepkoco.planning.config import PlannerConfig
from deepkoco.planning.errors import PlannerConfigError

DEVICES = ("cpu", "cuda")


OLDER_SETTINGS = {
    "keep": "last",
    "warm_start": 0.0,
    "scale": False,
    "measure_action_cost": False,
    "relative_cost": 0.0,
    "input_shrinkage": 0.0,
    "largest_gradient": 0.0,
    "noise_unit": "action",
    "noise_floor": 1.0,
    "rare_discount": 0.0,
    "fit_horizon": False,
}
"""How runs of earlier releases learned, whose stored settings do not name these."""


class TrainingConfigError(ValueError):
    """A hyper-parameter is out of range."""


def flatten(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings as one level, to compare them.

    Args:
        settings: Mappings inside mappings, as given by `dataclasses.asdict`.
        prefix: Put before every name.

    Returns:
        Dotted name to value; tuples as lists, which is what files make of them.
    """
    flat = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = list(value) if isinstance(value, tuple) else value
    return flat


@dataclass
class TrainingConfig:
    """Hyper-parameters of one run (Alg. 8); published values unless docs/training.md says otherwise."""

    name: str = "deepkoco"
    """Which agent this is."""
    model: ModelConfig = field(default_factory=ModelConfig)
    """Sizes of the latent model."""
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    """Settings of the planner."""
    value: ActionValueConfig = field(default_factory=ActionValueConfig)
    """A learned value of actions in the place of the cost, for goals beyond the horizon; none by default."""
    first_episodes: int = 90
    """Episodes of the first iteration, moved by noise alone unless `warm_start` says otherwise."""
    warm_start: float = 0.67
    """Share of the first episodes that the planner drives on EDMDc, fitted to those before, with exploration noise; 0:
    noise alone drives all of them, as published."""
    scale: bool = True
    """Learn from standardised observations and costs of a fixed mean, as found in the first episodes; off: from those
    of the environment, as published."""
    measure_action_cost: bool = True
    """With `scale`: measure in the first episodes what the task charges for actions and plan with that R; off: every
    task charges `model.action_weight`, as published."""
    relative_cost: float = 0.05
    """Share of the mean cost from which on errors of the cost count relative to it; 0: all alike, as published."""
    first_epochs: int = 100
    """Epochs on the first episodes."""
    iteration_episodes: int = 20
    """Episodes of every later iteration."""
    iteration_epochs: int = 3
    """Epochs over the whole buffer in every later iteration."""
    iteration_updates: int = 350
    """Cap on the updates of a later iteration."""
    total_episodes: int = 400
    """Episodes of the run; the last iteration collects what is missing."""
    horizon: int = 15
    """T, steps predicted in a training window of T + 1 steps."""
    rollout: str = "frozen"
    """B and C in a predicted window: "frozen" at its first step, or "updated": evaluated anew at every
    predicted step through the decoder, see model.decoder_hidden."""
    window_stride: int = 1
    """Steps between the starts of neighbouring windows; T + 1 for windows that do not overlap."""
    chunks: int = 8
    """G, chunks in a minibatch."""
    chunk_length: int = 40
    """L, consecutive steps of a chunk, which holds L - T overlapping windows."""
    learning_rate: float = 1e-3
    """Step size of Adam for the networks."""
    eigenvalue_learning_rate: float = 1e-2
    """Step size of Adam for mu [1/s] and omega [rad/s]."""
    final_learning_rate: float = 1.0
    """Share of both step sizes left in the last iteration; they fall linearly with the episodes after the first one."""
    cost_weight: float = 10.0
    """alpha_1, weight of cost reconstruction and prediction against the linear loss."""
    cost_discount: float = 0.0
    """gamma of the discounted mean of the costs to come that is learned in the place of a step's cost; for goals
    beyond the horizon; 0: the cost itself."""
    rare_discount: float = 0.95
    """With `scale`: gamma where the first episodes hardly ever show a reward within T steps (`out_of_sight`), or are
    too short for T (`fit_horizon`), and `cost_discount` is 0; 0: the cost itself, as published."""
    fit_horizon: bool = True
    """Where the task usually ends even calm random episodes before a training window is over, T and H are as short as
    half of these (`fitted_horizon`); off: as given, as published."""
    weight_penalty: float = 1e-14
    """alpha_2, weight of the squared parameters (L2), biases included; the published term excludes biases."""
    input_shrinkage: float = 0.0
    """What a step of Adam takes from weights of entries of the observation that the cost does not call for, in step
    sizes (`InputShrinkage`); 0: nothing, as published."""
    largest_gradient: float = 10.0
    """Norm that the gradient of an update is cut to; 0 for no limit, as published."""
    averaging: float = 0.998
    """Decay per update of the averaged weights, which act, are evaluated and are exported; 0 for none."""
    noise_correlation: float = 0.85
    """lambda of the Ornstein-Uhlenbeck noise, per step."""
    noise_variance: float = 0.85
    """Innovation variance of the noise before the first episode [`noise_unit` squared]."""
    noise_unit: str = "range"
    """Unit of the noise: "range": a quarter of the range of each action; "action": that of the action, as published. On
    the pendulum, whose torque is within -2 and 2, both are the same."""
    noise_floor: float = 0.1
    """Where the task itself ended most of the random episodes: noise of the calmest environment of a batch as a share
    of the boldest's, less where these episodes are too short to learn from (`calm_rounds`); 1: all alike, as
    published."""
    noise_last_episode: int = 400
    """Episode at which the variance has fallen linearly to zero."""
    evaluation_episodes: int = 20
    """Noise-free episodes after every iteration; 0 for none."""
    keep: str = "best"
    """Weights that are evaluated at the end and exported: "last": those of the end; "best": those of the iteration
    with the lowest mean cost of `evaluation_episodes`, whose start states are not those of the final evaluation. With
    `warm_start`, "best" is EDMDc of the run's own episodes where that did better than all weights."""
    final_evaluation_episodes: int = 200
    """Noise-free episodes at the end of the run."""
    reference_episodes: int = 50
    """Start states of the final evaluation from which zero action, random episodes and EDMDc with the same planner are
    measured too, to say whether the training was worth it; 0 for none."""
    device: str = "cpu"
    """Where the model is fitted and frames are kept, "cpu" or "cuda". Acting and episodes stay on the CPU."""
    checkpoint_updates: int = 1000
    """Updates between two checkpoints inside an iteration."""

    def check(self) -> None:
        """Check the ranges.

        Raises:
            TrainingConfigError: Names the first value that is out of range and its remedy.
            PlannerConfigError: The same for the planner, whose horizon H is at most T.
            UnknownSolverError: The planner's solver is not installed.
        """
        positive = (
            "first_episodes first_epochs iteration_episodes iteration_epochs iteration_updates "
            "total_episodes horizon window_stride chunks learning_rate eigenvalue_learning_rate noise_last_episode "
            "final_evaluation_episodes checkpoint_updates"
        )
        for name in positive.split():
            if not getattr(self, name) > 0:
                raise TrainingConfigError(f"{name} = {getattr(self, name)}; give a value above 0")
        for name in (
            "evaluation_episodes",
            "reference_episodes",
            "noise_variance",
            "cost_weight",
            "weight_penalty",
            "input_shrinkage",
        ):
            if not getattr(self, name) >= 0:
                raise TrainingConfigError(f"{name} = {getattr(self, name)}; give 0 or more")
        if not 0 < self.final_learning_rate <= 1:
            raise TrainingConfigError(
                f"final_learning_rate = {self.final_learning_rate}; give a value in (0, 1], 1 for constant steps"
            )
        if not 0 < self.noise_floor <= 1:
            raise TrainingConfigError(
                f"noise_floor = {self.noise_floor}; give a value in (0, 1], 1 for all alike"
            )
        for name in ("averaging", "noise_correlation", "cost_discount", "rare_discount", "warm_start"):
            if not 0 <= getattr(self, name) < 1:
                raise TrainingConfigError(f"{name} = {getattr(self, name)}; give a value in [0, 1)")
        if self.value.discount and self.cost_discount:
            raise TrainingConfigError(
                "value.discount and cost_discount take the place of the same cost; give one"
            )
        self.value.check()
        if self.noise_unit not in NOISE_UNITS:
            raise TrainingConfigError(
                f'noise_unit = "{self.noise_unit}"; choose one of {", ".join(NOISE_UNITS)}'
            )
        if self.keep not in KEPT:
            raise TrainingConfigError(f'keep = "{self.keep}"; choose one of {", ".join(KEPT)}')
        if self.keep == "best" and not self.evaluation_episodes:
            raise TrainingConfigError(
                'keep = "best" with evaluation_episodes = 0: nothing tells which is best; give episodes, '
                "e.g. 30, or keep = last"
            )
        if self.chunk_length <= self.horizon:
            raise TrainingConfigError(
                f"chunk_length = {self.chunk_length} holds no window of {self.horizon + 1} steps; "
                "give more than horizon"
            )
        if self.window_stride > 1 and self.chunk_length != self.horizon + 1:
            raise TrainingConfigError(
                f"window_stride = {self.window_stride} with chunk_length = {self.chunk_length}: windows of a chunk "
                f"overlap at stride 1; give chunk_length = {self.horizon + 1}, one window per chunk"
            )
        if self.device not in DEVICES:
            raise TrainingConfigError(f'device = "{self.device}"; choose one of {", ".join(DEVICES)}')
        if self.device == "cuda" and not torch.cuda.is_available():
            raise TrainingConfigError("device = cuda: torch sees no GPU here; give device = cpu")
        unknown = set(self.model.stop_gradients) - {"B", "C"}
        if unknown:
            raise TrainingConfigError(f"model.stop_gradients holds {sorted(unknown)}; it takes B and C")
        if self.model.cost_rank < 1:
            raise TrainingConfigError(f"model.cost_rank = {self.model.cost_rank}; give at least 1")
        if self.rollout not in ROLLOUTS:
            raise TrainingConfigError(f'rollout = "{self.rollout}"; choose one of {", ".join(ROLLOUTS)}')
        if (self.rollout == "updated") != bool(self.model.decoder_hidden):
            raise TrainingConfigError(
                f'rollout = "{self.rollout}" with model.decoder_hidden = {list(self.model.decoder_hidden)}; '
                "updated rollouts, and only they, train a decoder: give both or neither"
            )
        channels = self.model.frame_channels
        if min(self.model.frames, self.model.frame_features, *channels, len(channels)) < 1:
            raise TrainingConfigError(
                "model.frames, model.frame_features and model.frame_channels must be above 0"
            )
        if self.model.pairs < 1 or not self.model.time_step > 0:
            raise TrainingConfigError("model.pairs and model.time_step must be above 0")
        if not self.model.action_weight >= 0:
            raise TrainingConfigError(f"model.action_weight = {self.model.action_weight}; give 0 or more")
        if self.planner.linearisation in ("along_plan", "tangent") and not self.model.decoder_hidden:
            raise PlannerConfigError(
                f'planner.linearisation = "{self.planner.linearisation}" needs a model with a decoder; add '
                "rollout=updated model.decoder_hidden=[90,90]"
            )
        self.planner.check(self.horizon)

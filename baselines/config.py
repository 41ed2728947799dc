"""Hyper-parameters of the baselines; the defaults are those of the published code."""

from __future__ import annotations

from dataclasses import dataclass

from deepkoco.agent.config import TrainingConfigError

TRANSITIONS = ("deterministic", "probabilistic", "ensemble")
VARIANTS = ("code", "paper")
DECODERS = ("pixel", "identity")


class BaselineConfigError(TrainingConfigError):
    """A hyper-parameter of a baseline is out of range."""


@dataclass
class BaselineConfig:
    """What all baselines share: SAC, the encoder of observations, and how a run is carried out.

    Source: the hyper-parameters of Zhang et al. (2021), which are those of Yarats et al. (2021).
    """

    name: str = "sac"
    """The algorithm, a name of `baselines.registry`."""
    total_episodes: int = 400
    """Episodes of the run."""
    environments: int = 1
    """Environments stepped side by side; a step of each counts as one."""
    steps_per_update: int = 1
    """Steps for each update behind the random ones; more where updates are dear, as from images."""
    random_steps: int = 1000
    """Steps with uniformly drawn actions before anything is learned."""
    batch: int = 128
    """B, transitions of a minibatch."""
    hidden: int = 1024
    """Width of the two hidden layers of actor and critics."""
    learning_rate: float = 1e-3
    """Step size of Adam for actor and critics."""
    temperature: float = 0.1
    """alpha before the first update, weight of the entropy."""
    temperature_learning_rate: float = 1e-4
    """Step size of Adam for log alpha."""
    temperature_beta: float = 0.5
    """beta_1 of Adam for log alpha."""
    discount: float = 0.99
    """gamma, per step."""
    reward_scale: float = 1.0
    """Rewards are multiplied by it before they are learned from; published runs have rewards of 0 to 1 a step."""
    target_rate: float = 0.01
    """tau, share of the critics that their targets take over."""
    encoder_target_rate: float = 0.05
    """tau of the encoder."""
    actor_every: int = 2
    """Updates of the critics for each update of actor and temperature."""
    target_every: int = 2
    """Updates of the critics for each update of the targets."""
    log_sigma_min: float = -10.0
    """Lower limit of the log standard deviation of the actor's Gaussian, before tanh."""
    log_sigma_max: float = 2.0
    """Upper limit of the same."""
    encoder_hidden: tuple[int, ...] = (90, 90)
    """Widths of the hidden layers of the encoder of states, with ReLU; those of DeepKoCo."""
    features: int = 50
    """Z, entries of the latent, which a linear layer with LayerNorm gives."""
    frames: int = 3
    """d, newest frames that an observation is made of."""
    convolution_channels: tuple[int, ...] = (32, 32, 32, 32)
    """Channels of the convolutions of 3 x 3 of the encoder of frames."""
    convolution_strides: tuple[int, ...] = (2, 1, 1, 1)
    """Their strides, as many."""
    evaluation_every: int = 20
    """Episodes between two evaluations, each of which adds a row of metrics."""
    evaluation_episodes: int = 10
    """Noise-free episodes of an evaluation; 0 for none."""
    final_evaluation_episodes: int = 200
    """Noise-free episodes at the end of the run."""
    reference_episodes: int = 50
    """Start states of the final evaluation from which zero action, random episodes and EDMDc with DeepKoCo's planner
    are measured too; 0 for none."""
    checkpoint_episodes: int = 5
    """Episodes between two checkpoints."""

    def check(self) -> None:
        """Check the ranges.

        Raises:
            BaselineConfigError: Names the first value that is out of range and its remedy.
        """
        positive = (
            "total_episodes environments steps_per_update random_steps batch hidden learning_rate temperature "
            "temperature_learning_rate reward_scale actor_every target_every features frames evaluation_every "
            "final_evaluation_episodes checkpoint_episodes"
        )
        check_positive(self, *positive.split())
        for name in ("discount", "temperature_beta"):
            if not 0 <= getattr(self, name) < 1:
                raise BaselineConfigError(f"{name} = {getattr(self, name)}; give a value in [0, 1)")
        for name in ("target_rate", "encoder_target_rate"):
            if not 0 < getattr(self, name) <= 1:
                raise BaselineConfigError(f"{name} = {getattr(self, name)}; give a value in (0, 1]")
        for name in ("evaluation_episodes", "reference_episodes"):
            if getattr(self, name) < 0:
                raise BaselineConfigError(f"{name} = {getattr(self, name)}; give 0 or more")
        if not self.log_sigma_min < self.log_sigma_max:
            raise BaselineConfigError(
                f"log_sigma_min = {self.log_sigma_min} is not below log_sigma_max = {self.log_sigma_max}"
            )
        for name in ("encoder_hidden", "convolution_channels", "convolution_strides"):
            if any(value < 1 for value in getattr(self, name)):
                raise BaselineConfigError(f"{name} = {list(getattr(self, name))}; give values above 0")
        if not self.convolution_channels or len(self.convolution_channels) != len(self.convolution_strides):
            raise BaselineConfigError(
                f"convolution_strides = {list(self.convolution_strides)} with convolution_channels = "
                f"{list(self.convolution_channels)}; give one stride for each convolution, at least one"
            )


@dataclass
class SacConfig(BaselineConfig):
    """SAC whose actor and critics each have their own network, from the observation on."""

    name: str = "sac"
    """The algorithm."""


@dataclass
class SharedSacConfig(BaselineConfig):
    """SAC whose actor sees through the encoder of the critics, which the actor does not train."""

    name: str = "sac_shared"
    """The algorithm."""


@dataclass
class DeepMdpConfig(BaselineConfig):
    """DeepMDP: a latent that predicts its successor and the reward."""

    name: str = "deepmdp"
    """The algorithm."""
    transition: str = "deterministic"
    """Model of the next latent: "deterministic", "probabilistic" or "ensemble" of five probabilistic ones."""
    decoder: str = "pixel"
    """What else the predicted next latent has to give: "pixel", a frame, where frames are observed; or
    "identity", nothing."""
    encoder_learning_rate: float = 1e-3
    """Step size of the encoder's second Adam, for the losses of the models."""
    model_learning_rate: float = 1e-3
    """Step size of Adam for transition, reward and decoder."""

    def check(self) -> None:
        super().check()
        check_choice("transition", self.transition, TRANSITIONS)
        check_choice("decoder", self.decoder, DECODERS)
        check_positive(self, "encoder_learning_rate", "model_learning_rate")


@dataclass
class DbcConfig(BaselineConfig):
    """Deep bisimulation for control: distances of latents are those of behaviour."""

    name: str = "dbc"
    """The algorithm."""
    variant: str = "code"
    """The bisimulation loss: as in the published "code", or as in Eq. 4 of the "paper"."""
    transition: str = "probabilistic"
    """Model of the next latent: "deterministic", "probabilistic" or "ensemble" of five probabilistic ones."""
    bisimulation_weight: float = 0.5
    """Weight of the bisimulation loss against those of transition and reward."""
    encoder_learning_rate: float = 1e-3
    """Step size of the encoder's second Adam, for the losses of the models."""
    model_learning_rate: float = 1e-3
    """Step size of Adam for transition and reward."""

    def check(self) -> None:
        super().check()
        check_choice("variant", self.variant, VARIANTS)
        check_choice("transition", self.transition, TRANSITIONS)
        check_positive(self, "encoder_learning_rate", "model_learning_rate")
        if not self.bisimulation_weight >= 0:
            raise BaselineConfigError(f"bisimulation_weight = {self.bisimulation_weight}; give 0 or more")


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Raise BaselineConfigError for a value that is none of the choices."""
    if value not in choices:
        raise BaselineConfigError(f'{name} = "{value}"; choose one of {", ".join(choices)}')


def check_positive(config: object, *names: str) -> None:
    """Raise BaselineConfigError for a named value that is not above 0."""
    for name in names:
        if not getattr(config, name) > 0:
            raise BaselineConfigError(f"{name} = {getattr(config, name)}; give a value above 0")

"""Typed settings of the experiment commands, registered with Hydra."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from omegaconf import MISSING

from deepkoco.agent.config import TrainingConfig, flatten
from deepkoco.envs.distractors import DistractorOptions
from deepkoco.envs.task_factory import OBSERVATIONS, TaskConfig

EXISTING = ("refuse", "resume")
OF_THE_CALL = ("run", "resume", "existing", "threads")


class ExperimentError(ValueError):
    """A setting or folder given to an experiment command is wrong."""


@dataclass
class TrainRunConfig:
    """Settings of one training run."""

    task: TaskConfig = field(default_factory=TaskConfig)
    """The environment, a file of configs/task."""
    agent: Any = field(default_factory=TrainingConfig)
    """Hyper-parameters of the agent, a file of configs/agent."""
    seed: int = 0
    """Seed of everything: weights, episodes, noise, distractors."""
    observation: str = "states"
    """What the agent sees: "states", or "images": one uint8 RGB frame (64, 64, 3) per step."""
    distractors: str = "none"
    """Distractors: "none", or of states "copies", "noise", "projection", of images "copies", "background", "video",
    "colour", "camera", "sensor_noise"; several are joined by "+"."""
    distractor_options: DistractorOptions = field(default_factory=DistractorOptions)
    """How strong they are, and how many."""
    run: str = "runs/${agent.name}/${task.name}/${observation}/${distractors}/seed_${seed}"
    """Folder of the run; it must not exist."""
    resume: str | None = None
    """Folder of a run to continue, with the settings stored there."""
    existing: str = "refuse"
    """What to do where the folder is there already: "refuse", or "resume": go on with a run of the same
    settings and leave a finished one as it is, so that an interrupted sweep is started again as it was."""
    threads: int = 1
    """Threads of torch; more than one is slower on networks of this size."""

    def check(self) -> None:
        """Check what is not a hyper-parameter.

        Raises:
            ExperimentError: Names the first value that is out of range and its remedy.
        """
        if self.seed < 0:
            raise ExperimentError(f"seed = {self.seed}; give 0 or more")
        if self.threads < 1:
            raise ExperimentError(f"threads = {self.threads}; give at least 1")
        if self.observation not in OBSERVATIONS:
            raise ExperimentError(
                f'observation = "{self.observation}"; choose one of {", ".join(OBSERVATIONS)}'
            )
        if self.existing not in EXISTING:
            raise ExperimentError(f'existing = "{self.existing}"; choose one of {", ".join(EXISTING)}')

    def identity(self) -> dict[str, Any]:
        """What decides the result: dotted setting to value, without the folder and how the run is started."""
        return {name: value for name, value in flatten(asdict(self)).items() if name not in OF_THE_CALL}


@dataclass
class EvaluateConfig:
    """Settings of an evaluation."""

    run: str = MISSING
    """Folder of a finished run."""
    episodes: int = 200
    """Noise-free episodes; the standard error of 50 pendulum episodes is 12, of 200 it is 6."""
    seed: int = 0
    """Which set of start states; never one of training."""
    distractors: str | None = None
    """Distractors in the place of those of training; the observation must keep its shape."""
    intensity: float | None = None
    """Intensity of all of them in the place of that of training, 0 to 1."""
    sensing_delay: Any = 0.0
    """Delay of observations [s], or a law such as {law:uniform,low:0.0,high:0.2}, beside the task's own."""
    actuation_delay: Any = 0.0
    """Delay of actions, likewise."""
    in_order: bool = True
    """Messages cannot overtake each other; false: what a newer one has overtaken is dropped."""
    compensate: str = "none"
    """Whether DeepKoCo bridges these delays: "none", "measured": told what time stamps tell, "law": told the means of
    the delays, "both"."""
    increment_weight: float | None = None
    """R~ of DeepKoCo's planner in the place of the stored one; 0.3 to 1 makes it bear random delays of actions."""
    roll: str = "observation"
    """What is rolled to the time of action: the "observation", or the "latent"."""
    json: bool = False
    """Print one JSON object instead of a line of text."""
    upright_steps: int = 50
    """Steps at the end of an episode that tell whether it is upright."""
    upright_cost: float = 0.25
    """Largest mean cost of those steps; 0.25 is an angle of 0.5 rad off on the pendulum tasks."""

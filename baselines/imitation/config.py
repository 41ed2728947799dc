"""Settings of interactive imitation."""

from __future__ import annotations

from dataclasses import dataclass

from baselines.config import BaselineConfigError, check_positive

RULES = ("doubt", "drawn", "weighted", "fixed", "novelty", "random", "always")


@dataclass
class ImitationConfig:
    """A policy that asks a teacher for the action of some steps and learns from the answers.

    Source: Ross, Gordon and Bagnell (2011), A reduction of imitation learning and structured prediction to no-regret
    online learning (DAgger); Zhang and Cho (2017), Query-efficient imitation learning for end-to-end simulated driving
    (SafeDAgger); Menda, Driggs-Campbell and Kochenderfer (2019), EnsembleDAgger; Hoque et al. (2021), ThriftyDAgger,
    whose threshold follows from the wanted share of questions.
    """

    name: str = "imitation"
    """The algorithm."""
    teacher: str = "optimal"
    """Who answers: "optimal" (planning on the task's own equations), "keys" (a person at the keyboard), the folder of a
    trained run, or FILE.py:FUNCTION, a function from observations (B, N) to actions (B, M). Relative paths are looked
    up where the command runs."""
    rule: str = "doubt"
    """Which steps are asked about: "doubt" (where the members disagree most), "drawn" (with a probability that grows
    with the doubt), "weighted" (drawn, and an answer counts the more, the less likely its question was), "fixed" (the
    doubt is above `smallest_doubt`), "novelty" (farthest from all answered observations), "random", "always" (as
    DAgger)."""
    query_rate: float = 0.05
    """Wanted share of steps that are asked about; the thresholds of doubt and novelty adapt to it."""
    threshold_gain: float = 0.1
    """How fast the logarithm of the threshold follows: it rises by this per step if all is asked, less the rate."""
    smallest_doubt: float = 0.0
    """Doubt, in half ranges of the action, below which nothing is asked; the rate may then be lower than wanted. The
    threshold of rule=fixed."""
    teacher_acts: bool = False
    """Where an answer comes within its step it acts, as in SafeDAgger and EnsembleDAgger; else the student always
    acts. With rule=always this is behaviour cloning."""
    answer_delay: tuple[int, int] = (0, 0)
    """Fewest and most steps until an answer comes, drawn evenly for each."""
    demonstrations: int = 1
    """Episodes at the beginning in which the teacher acts; each of their steps counts as a question."""
    environments: int = 4
    """B, environments stepped side by side in a round."""
    total_episodes: int = 121
    """Episodes of the run; it ends with the round in which they are reached."""
    query_budget: int | None = None
    """Questions after which nothing is asked any more and the run ends with its round; none: no limit."""
    members: int = 5
    """E, networks of the ensemble."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of each, with tanh."""
    updates: int = 300
    """Steps of Adam after each round."""
    minibatch: int = 128
    """Answers of a step, the same for all members."""
    learning_rate: float = 2e-3
    """Step size of Adam at the beginning of the updates of a round."""
    final_learning_rate: float = 0.05
    """Share of it that is left at their end; it falls linearly."""
    observation_limit: float = 10.0
    """Scaled observations are clipped to this."""
    evaluation_every: int = 4
    """Episodes between two evaluations, each of which adds a row of metrics."""
    evaluation_episodes: int = 20
    """Noise-free episodes of an evaluation; 0 for none."""
    final_evaluation_episodes: int = 200
    """Noise-free episodes at the end of the run."""
    reference_episodes: int = 50
    """Start states of the final evaluation from which zero action, random episodes and EDMDc with DeepKoCo's planner
    are measured too; 0 for none."""
    checkpoint_episodes: int = 4
    """Episodes between two checkpoints."""

    def check(self) -> None:
        """Check the ranges.

        Raises:
            BaselineConfigError: Names the first value that is out of range and its remedy.
        """
        positive = (
            "threshold_gain demonstrations environments total_episodes members updates minibatch learning_rate "
            "observation_limit evaluation_every final_evaluation_episodes checkpoint_episodes"
        )
        check_positive(self, *positive.split())
        if self.query_budget is not None:
            check_positive(self, "query_budget")
        if self.rule not in RULES:
            raise BaselineConfigError(f'rule = "{self.rule}"; choose one of {", ".join(RULES)}')
        if not 0 < self.query_rate < 1:
            raise BaselineConfigError(
                f"query_rate = {self.query_rate}; give a value between 0 and 1 (rule=always asks about all steps)"
            )
        if not 0 < self.final_learning_rate <= 1:
            raise BaselineConfigError(
                f"final_learning_rate = {self.final_learning_rate}; give a value in (0, 1]"
            )
        if self.rule == "fixed":
            check_positive(self, "smallest_doubt")
        for name in ("smallest_doubt", "evaluation_episodes", "reference_episodes"):
            if not getattr(self, name) >= 0:
                raise BaselineConfigError(f"{name} = {getattr(self, name)}; give 0 or more")
        fewest, most = self.answer_delay
        if not 0 <= fewest <= most:
            raise BaselineConfigError(
                f"answer_delay = {list(self.answer_delay)}; give fewest and most steps, 0 or more"
            )
        if self.teacher == "keys" and (self.environments, self.demonstrations) != (1, 1):
            raise BaselineConfigError(
                f"environments = {self.environments}, demonstrations = {self.demonstrations}: a person answers one "
                "environment at a time; give environments=1 and demonstrations=1"
            )
        if any(width < 1 for width in self.hidden):
            raise BaselineConfigError(f"hidden = {list(self.hidden)}; give values above 0")

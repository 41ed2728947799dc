"""A round of episodes: the student acts, some steps are asked about, answers are joined to what they answer."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv

from baselines.imitation.asking import Rule, Seen
from baselines.imitation.ensemble import Ensemble
from baselines.imitation.learner import Labels
from baselines.imitation.questions import Label, OpenQuestions, Questions
from baselines.imitation.teachers.teacher import Teacher
from baselines.policy import Array


@dataclass
class Lesson:
    """What a round gave.

    Attributes:
        answered: Questions with their answers.
        steps: Steps of episodes.
        costs: Of each episode (B,).
        asked: Questions.
        unanswered: Questions without an answer.
        doubts: Mean doubt of the steps.
    """

    answered: list[Label] = field(default_factory=list)
    steps: int = 0
    costs: Array = field(default_factory=lambda: np.empty(0))
    asked: int = 0
    unanswered: int = 0
    doubts: float = 0.0


def give_lesson(
    envs: VectorEnv,
    seed: int,
    ensemble: Ensemble,
    labels: Labels,
    rule: Rule,
    teacher: Teacher,
    acts: bool = False,
    budget: int | None = None,
) -> Lesson:
    """Run every environment from a reset to the end of its first episode.

    Args:
        envs: B environments.
        seed: Of their reset, and of the teacher's draws.
        ensemble: The student.
        labels: What was answered before; it stays as it is.
        rule: Chooses the steps to ask about.
        teacher: Answers.
        acts: Whether an answer that comes within its step acts.
        budget: Most questions; none: no limit.

    Returns:
        What was answered, asked and paid.
    """
    lesson, waiting = Lesson(), OpenQuestions()
    observation, _ = envs.reset(seed=seed)
    teacher.start(envs, seed)
    dtype, restarts = envs.single_action_space.dtype, envs.metadata.get("autoreset_mode")
    running = np.ones(envs.num_envs, bool)
    costs, doubts, step = np.zeros(envs.num_envs), [], 0
    while running.any():
        seen = np.asarray(observation, np.float64)
        tensor = torch.from_numpy(seen)
        decided, doubt = ensemble.decide(tensor)
        actions = decided.numpy()
        weights = rule.choose(ensemble, labels, Seen(tensor, doubt, running))
        if budget is not None:
            weights = np.where(np.cumsum(weights > 0) <= budget - lesson.asked, weights, 0.0)
        questions = Questions(step, weights, seen)
        waiting.put(questions)
        answers = teacher.answer(questions)
        lesson.answered += waiting.join(answers)
        if acts:
            now = answers.take(answers.steps == step)
            actions[now.environments] = now.actions
        lesson.steps += int(running.sum())
        doubts.append(doubt.numpy()[running])
        lesson.asked += int(questions.asked.sum())
        observation, reward, terminated, truncated, _ = envs.step(actions.astype(dtype))
        costs -= np.where(running, np.asarray(reward, np.float64), 0.0)
        ended = terminated | truncated
        running &= ~ended
        step += 1
        if ended.any() and running.any() and restarts == AutoresetMode.DISABLED:
            observation, _ = envs.reset(options={"reset_mask": ended})
    lesson.answered += waiting.join(teacher.finish())
    lesson.costs = costs
    lesson.unanswered, lesson.doubts = waiting.clear(), float(np.concatenate(doubts).mean())
    return lesson

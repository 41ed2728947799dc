"""Film of a student that learns the swing-up from answers: episodes of some rounds, with the questions marked.

python -m experiments.studies.learning.imitation_film --out results/imitation
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from gymnasium.vector import VectorEnv

from baselines.imitation.config import ImitationConfig
from baselines.imitation.questions import Answers, Questions
from baselines.imitation.teachers import Teacher, make_teacher
from baselines.imitation.training import ImitationTrainer
from deepkoco.envs.film import FilmError, film_strip, write_clip
from deepkoco.envs.task_factory import TaskConfig, make_task_factory
from deepkoco.runs.configs import CONFIGS
from deepkoco.yaml_file import read_yaml

ROUNDS = (0, 1, 10, 25, 50)
BANNER = 44  # rows above a picture
ASKED, QUIET = (213, 94, 0), (70, 70, 70)


class FilmedTeacher:
    """Another teacher, and a picture of each step that it is shown, in chosen rounds.

    Attributes:
        frames: By round, pictures uint8 (height, width, 3).
    """

    def __init__(self, teacher: Teacher, rounds: Sequence[int]) -> None:
        """Set up.

        Args:
            teacher: Answers.
            rounds: That are filmed.
        """
        self._teacher, self._round, self._questions = teacher, -1, 0
        self.frames: dict[int, list[np.ndarray]] = {number: [] for number in rounds}

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Begin a round."""
        self._teacher.start(envs, seed)
        self._envs, self._round = envs, self._round + 1

    def answer(self, questions: Questions) -> Answers:
        """The answers of the other teacher; the step is filmed."""
        self._questions += int(questions.asked.sum())
        if self._round in self.frames:
            pictures = self._envs.render()
            assert pictures is not None
            self.frames[self._round].append(self._marked(np.asarray(pictures[0]), bool(questions.asked[0])))
        return self._teacher.answer(questions)

    def finish(self) -> Answers:
        """What the other teacher still has."""
        return self._teacher.finish()

    def close(self) -> None:
        """Close the other teacher."""
        self._teacher.close()

    def _marked(self, picture: np.ndarray, asked: bool) -> np.ndarray:
        """The picture below a banner that is coloured where an answer is asked for."""
        colour = ASKED if asked else QUIET
        marked = np.full((picture.shape[0] + BANNER, picture.shape[1], 3), 255, np.uint8)
        marked[BANNER:] = picture
        marked[:BANNER] = colour
        shown = (
            "demonstration" if self._round == 0 else f"episode {self._round}" + (": asks" if asked else "")
        )
        for row, text in ((17, shown), (36, f"{self._questions} questions")):
            cv2.putText(
                marked, text, (6, row), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA
            )
        return marked


def film(rounds: Sequence[int], seed: int = 0, **changes: object) -> dict[int, list[np.ndarray]]:
    """Train on the pendulum and film some rounds.

    Args:
        rounds: Numbers of rounds; 0 is the demonstration.
        seed: Of the run.
        **changes: Of the settings.

    Returns:
        By round, a picture of each step.
    """
    stored = read_yaml(CONFIGS / "task" / "pendulum.yaml")
    make = make_task_factory(TaskConfig(**stored), render_mode="rgb_array", render_size=192)
    teacher = FilmedTeacher(make_teacher("optimal"), rounds)
    config = ImitationConfig(
        **{
            "rule": "doubt", "environments": 1, "total_episodes": max(rounds) + 1, "query_rate": 0.1, "updates": 150,
            "evaluation_episodes": 0, "final_evaluation_episodes": 1, "reference_episodes": 0, **changes,
        }
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        ImitationTrainer(make, config, seed, Path(folder), teacher=teacher).run()
    return teacher.frames


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Film of a student that learns the swing-up from answers.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the film")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    frames = film(ROUNDS)
    args.out.mkdir(parents=True, exist_ok=True)
    strips = [film_strip(frames[number], 8) for number in ROUNDS]
    cv2.imwrite(str(args.out / "film.png"), cv2.cvtColor(np.concatenate(strips), cv2.COLOR_RGB2BGR))
    try:
        write_clip(args.out / "film.webm", [each for number in ROUNDS for each in frames[number]], 40.0)
    except (FileExistsError, FilmError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

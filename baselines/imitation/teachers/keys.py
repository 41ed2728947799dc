"""A person at the keyboard as the teacher, at the pace of the task."""

from __future__ import annotations

import sys
import time
from typing import TextIO

import numpy as np
from gymnasium.vector import VectorEnv

from baselines.imitation.questions import Answers, Questions
from baselines.imitation.teachers.keyboard import PAIRS, Keyboard, action_of, terminal_picture
from baselines.imitation.teachers.teacher import TeacherError

REACTION = (
    0.25  # from what a person sees to the key [s]; Woodworth & Schlosberg: about 0.2 s for a simple signal
)
USUAL_PACE = 0.05  # of an environment that does not tell its own [s]


class KeyTeacher:
    """Shows one environment on the terminal and takes the keys that are held as answers.

    A key answers what was seen `reaction` seconds before: the newest question that is at least so old. Where no key is
    held there is no answer, and the question stays open. The steps have the pace of the clock, so a run by a person
    cannot be repeated bit for bit.
    """

    def __init__(
        self,
        descriptor: int | None = None,
        reaction: float = REACTION,
        pace: float | None = None,
        screen: TextIO | None = None,
    ) -> None:
        """Wait for the first episode.

        Args:
            descriptor: Of the terminal with the keys; None: that of the standard input.
            reaction: Of the person [s].
            pace: Time of a step [s]; None: that of the task.
            screen: Where the picture goes; None: the standard output.
        """
        self._descriptor, self._reaction, self._pace = descriptor, reaction, pace
        self._screen, self._keyboard = screen or sys.stdout, None

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Open the keyboard, at the first episode.

        Raises:
            TeacherError: There are several environments, or there is no terminal.
        """
        if envs.num_envs != 1:
            raise TeacherError(f'teacher = "keys": {envs.num_envs} environments; a person answers one')
        space = envs.single_action_space
        self._low, self._high = (np.asarray(end, np.float64) for end in (space.low, space.high))  # pyright: ignore
        if self._keyboard is None:
            self._keyboard = Keyboard(self._descriptor)
            pairs = ", ".join(f"{a} and {b}" for a, b in PAIRS[: len(self._low)])
            self._write(
                f"\x1b[2J\x1b[28;1Hkeys: {pairs}; space: the middle. Answer while the picture says ASKED.\n"
            )
        self._envs, self._asked = envs, []
        self._next = time.monotonic()

    def answer(self, questions: Questions) -> Answers:
        """Show the step, wait until its time is over, and take the key that is held then."""
        assert self._keyboard is not None
        now = time.monotonic()
        if questions.asked[0]:
            self._asked.append((now, questions.step))
        self._show(bool(questions.asked[0]))
        self._next = max(self._next + self._time_step, now)
        keys = self._keyboard.held(max(0.0, self._next - now))
        action = action_of(keys, self._low, self._high)
        old = [entry for entry in self._asked if entry[0] <= time.monotonic() - self._reaction]
        if action is None or not old:
            return Answers.none(len(self._low))
        self._asked = self._asked[len(old) :]
        return Answers(np.zeros(1, np.int64), np.array([old[-1][1]]), action[None])

    def finish(self) -> Answers:
        """What is not answered stays so."""
        return Answers.none(len(self._low))

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._keyboard is not None:
            self._keyboard.close()
            self._keyboard = None

    @property
    def _time_step(self) -> float:
        if self._pace is not None:
            return self._pace
        own = getattr(self._envs.unwrapped, "dt", None)
        fps = self._envs.metadata.get("render_fps")
        return float(own or (1.0 / fps if fps else USUAL_PACE))

    def _show(self, asked: bool) -> None:
        pictures = self._envs.render() if self._envs.render_mode == "rgb_array" else None
        drawn = "" if not pictures else terminal_picture(np.asarray(pictures[0]))
        # Drawn from the corner, with the cursor put back: the progress bar below knows nothing of it.
        self._write(f"\x1b7\x1b[1;1H{drawn}\n{'ASKED' if asked else '     '}\x1b8")

    def _write(self, text: str) -> None:
        self._screen.write(text)
        self._screen.flush()

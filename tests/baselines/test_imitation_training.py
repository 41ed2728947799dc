"""Runs of interactive imitation: learning, teachers, late answers, a person at the keyboard, a stop, the policy."""

import io
import os
import pty
import time

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from test_baseline_training import same
from tracking import STEPS, Tracking, make_pictures, make_tracking

from baselines.imitation.asking import Always, AtRandom
from baselines.imitation.config import ImitationConfig
from baselines.imitation.learner import Labels
from baselines.imitation.lessons import give_lesson
from baselines.imitation.policy import load_policy, make_ensemble, read_ensemble
from baselines.imitation.questions import Questions
from baselines.imitation.teachers import TeacherError, make_teacher
from baselines.imitation.teachers.function import FunctionTeacher
from baselines.imitation.teachers.keyboard import Keyboard, action_of, terminal_picture
from baselines.imitation.teachers.keys import KeyTeacher
from baselines.imitation.teachers.late import LateTeacher
from baselines.imitation.training import ImitationTrainer
from baselines.ppo.config import PpoConfig
from baselines.ppo.policy import read_networks
from baselines.ppo.training import PpoTrainer
from deepkoco.agent.checkpoint import CheckpointError, load_checkpoint
from deepkoco.agent.collection import SpaceError
from deepkoco.envs.task_factory import TaskConfig, make_task_factory
from deepkoco.koopman.files.folder_files import ModelFolderError
from deepkoco.optimal import TrueModel, ValueIteration, play, start_states

SMALL = {
    "hidden": (16,), "members": 3, "environments": 2, "updates": 20, "minibatch": 16, "total_episodes": 9,
    "evaluation_every": 4, "evaluation_episodes": 2, "final_evaluation_episodes": 3, "checkpoint_episodes": 2,
    "reference_episodes": 0, "query_rate": 0.3,
}  # fmt: skip
TEACHER = """
import numpy as np

def track(observations):
    return 2 * observations

def wrong(observations):
    return observations[:1]
"""


@pytest.fixture
def teacher(tmp_path):
    path = tmp_path / "teacher.py"
    path.write_text(TEACHER)
    return f"{path}:track"


def small(teacher, **changes):
    return ImitationConfig(**{**SMALL, "teacher": teacher, **changes})


def folder(tmp_path, name="run"):
    (tmp_path / name).mkdir()
    return tmp_path / name


def student(config, size=1):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return make_ensemble(size, np.array([-2.0]), np.array([2.0]), config)


def lesson(envs, teacher, rule=None, **options):
    config = ImitationConfig(members=3, hidden=(8,))
    return give_lesson(envs, 3, student(config), Labels(1, 1, 3), rule or Always(), teacher, **options)


def test_learns_to_track_from_few_answers(teacher, tmp_path):
    config = small(
        teacher, members=5, updates=200, learning_rate=1e-2, total_episodes=41, query_rate=0.1, evaluation_every=20,
        final_evaluation_episodes=20,
    )  # fmt: skip
    last = ImitationTrainer(make_tracking, config, 1, folder(tmp_path)).run()
    # Actions of 0 cost 10 E[x^2] = 3.3 an episode.
    assert last["evaluation/cost"] < 0.1
    assert last["steps"] == 41 * STEPS
    # The demonstration, and at most a tenth of the 200 steps of twenty rounds, for the doubt falls meanwhile.
    assert STEPS < last["queries"] <= STEPS + 20


def test_rows_have_the_names_of_all_agents(teacher, tmp_path):
    trainer = ImitationTrainer(make_tracking, small(teacher, reference_episodes=3), 0, folder(tmp_path))
    told = []
    trainer.run(told.append)
    names = "episodes steps updates train/cost train/cost_sd evaluation/cost evaluation/cost_sd evaluation/cost_median"
    assert {*names.split(), "evaluation/episodes", "seconds", "queries"} <= set(trainer.metrics.rows[0])
    assert [row["episodes"] for row in trainer.metrics.rows] == [5, 9]
    assert told[-1].completed == told[-1].total == 9
    assert (tmp_path / "run" / "references.json").exists()


@pytest.mark.parametrize("rule", ["doubt", "weighted", "random", "novelty"])
@pytest.mark.parametrize("failing", [3, 31])
def test_a_run_that_fails_at_any_step_goes_on_bit_for_bit(rule, failing, teacher, tmp_path):
    class StoppedError(Exception):
        pass

    done = 0

    class Failing(Tracking):
        def step(self, actions):
            nonlocal done
            done += self.num_envs == 2
            if done == failing:
                raise StoppedError
            return super().step(actions)

    config = small(teacher, rule=rule, answer_delay=(0, 3), evaluation_episodes=0)
    for name in "ab":
        folder(tmp_path, name)
    with pytest.raises(StoppedError):
        ImitationTrainer(lambda count, seed: Failing(count), config, 3, tmp_path / "a").run()
    for name in "ab":
        ImitationTrainer(make_tracking, config, 3, tmp_path / name).run()
    assert same(*(load_checkpoint(tmp_path / name / "checkpoint.pt") for name in "ab"))
    weights = [(tmp_path / name / "model" / "model.safetensors").read_bytes() for name in "ab"]
    assert weights[0] == weights[1]


def test_other_settings_do_not_go_on_with_a_checkpoint(teacher, tmp_path):
    own = folder(tmp_path)
    ImitationTrainer(make_tracking, small(teacher), 0, own).run()
    with pytest.raises(CheckpointError, match="members = 3 instead of 4"):
        ImitationTrainer(make_tracking, small(teacher, members=4), 0, own)


def test_a_run_ends_when_its_questions_are_spent(teacher, tmp_path):
    config = small(teacher, query_budget=STEPS + 4, rule="always", total_episodes=99)
    last = ImitationTrainer(make_tracking, config, 0, folder(tmp_path)).run()
    assert last["queries"] == STEPS + 4
    assert last["episodes"] == 3


def test_the_stored_policy_acts_as_the_trained_one(teacher, tmp_path):
    trainer = ImitationTrainer(make_tracking, small(teacher), 0, folder(tmp_path))
    trainer.run()
    observations = np.linspace(-1, 1, 7)[:, None]
    loaded = load_policy(tmp_path / "run", 7)
    assert np.array_equal(loaded.act(observations), trainer.policy.act(observations))
    with pytest.raises(ModelFolderError, match="kind 'imitation', not 'ppo'"):
        read_networks(tmp_path / "run")
    (tmp_path / "run" / "model" / "model.safetensors").write_bytes(b"x")
    with pytest.raises(ModelFolderError):
        read_ensemble(tmp_path / "run")


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_every_answer_belongs_to_the_step_it_was_asked_about(mode, teacher):
    """Two environments of 3 and 7 steps, answers up to four steps late, some behind the end."""
    envs = Tracking(2, mode=mode, lengths=[3, 7])
    given = lesson(envs, LateTeacher(FunctionTeacher(teacher), 0, 4))
    assert given.asked == given.steps == len(given.answered) == 10
    assert all(np.array_equal(label.action, 2 * label.observation) for label in given.answered)
    assert given.unanswered == 0


def test_answers_within_their_step_act_where_they_may():
    class Watching(Tracking):
        def step(self, actions):
            self.apart = max(getattr(self, "apart", 0.0), float(np.abs(actions[:, 0] / 2 - self.x).max()))
            return super().step(actions)

    class Teacher(FunctionTeacher):
        def __init__(self):
            self._act, self._reference = (lambda observations: 2 * observations), "here"

    apart = {}
    for acts in (True, False):
        envs = Watching(3)
        lesson(envs, Teacher(), acts=acts)
        apart[acts] = envs.apart
    assert apart[True] < 1e-6 < apart[False]
    late = Watching(3)
    lesson(late, LateTeacher(Teacher(), 1, 1), acts=True)  # of an observation that is over: nothing to do now
    assert late.apart > 0.1


def test_questions_beyond_the_budget_are_not_asked(teacher):
    given = lesson(Tracking(3), FunctionTeacher(teacher), budget=7)
    assert given.asked == len(given.answered) == 7


def test_random_questions_have_their_share(teacher):
    rule = AtRandom(0.2, torch.Generator().manual_seed(0))
    given = lesson(Tracking(50), FunctionTeacher(teacher), rule)
    assert given.asked / given.steps == pytest.approx(0.2, abs=0.05)


def test_a_trained_run_teaches(tmp_path):
    from omegaconf import OmegaConf

    from deepkoco.runs.settings import TrainRunConfig

    own = folder(tmp_path, "ppo")
    config = PpoConfig(
        hidden=(16,), environments=4, steps=STEPS, minibatch=20, epochs=1, total_episodes=4, reference_episodes=0,
        evaluation_episodes=0, final_evaluation_episodes=1,
    )  # fmt: skip
    trainer = PpoTrainer(make_tracking, config, 0, own)
    trainer.run()
    OmegaConf.save(
        OmegaConf.structured(TrainRunConfig(task=TaskConfig("t", "t"), agent=config)), own / "config.yaml"
    )
    taught = make_teacher(str(own))
    given = lesson(Tracking(2), taught)
    for label in given.answered:
        assert label.action == pytest.approx(trainer.policy.act(label.observation[None])[0])
    with pytest.raises(TeacherError, match="was trained on another task"):
        taught.answer(Questions(0, np.ones(2, bool), np.zeros((2, 5))))


def test_the_optimal_teacher_knows_the_true_state():
    make = make_task_factory(TaskConfig("p", "deepkoco/RodPendulum-v0", kwargs={"max_episode_steps": 12}))
    envs, taught = make(3, 0), make_teacher("optimal")
    observation, _ = envs.reset(seed=5)
    taught.start(envs, 0)
    costs = np.zeros(3)
    for step in range(12):
        answers = taught.answer(Questions(step, np.ones(3, bool), observation))
        observation, reward, *_ = envs.step(answers.actions.astype(np.float32))
        costs -= reward
    model = TrueModel.of(make(3, 0))
    iteration = ValueIteration(model, 301, 301, 21)
    expected = play(model, start_states(make(3, 0), 5), 12, iteration.controller(iteration.solve(12)))
    assert costs == pytest.approx(expected.total.numpy(), rel=1e-3)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere", "no folder of a trained run; give one, optimal, keys, or FILE.py:FUNCTION"),
        ("nowhere.py:act", "nowhere.py"),
    ],
)
def test_a_teacher_that_is_not_there_is_named(name, message):
    with pytest.raises(TeacherError, match=message):
        make_teacher(name)


def test_a_function_of_another_shape_is_refused(teacher):
    with pytest.raises(TeacherError, match=r"return finite actions of shape \(2, 1\)"):
        lesson(Tracking(2), FunctionTeacher(teacher.replace("track", "wrong")))


def test_a_task_without_equations_has_no_optimal_teacher(tmp_path):
    with pytest.raises(TeacherError, match="does not tell its equations"):
        ImitationTrainer(make_tracking, small("optimal"), 0, folder(tmp_path)).run()


def test_images_are_refused(teacher, tmp_path):
    with pytest.raises(SpaceError, match="imitation learns from states"):
        ImitationTrainer(make_pictures, small(teacher), 0, folder(tmp_path))


@pytest.fixture
def terminal():
    ours, theirs = pty.openpty()
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


def test_keys_stand_for_actions():
    low, high = np.array([-2.0, 0.0]), np.array([2.0, 10.0])
    assert action_of(frozenset("d"), low, high).tolist() == [2.0, 5.0]
    assert action_of(frozenset("aw"), low, high).tolist() == [-2.0, 10.0]
    assert action_of(frozenset("ad"), low, high).tolist() == [0.0, 5.0]
    assert action_of(frozenset(" "), low, high).tolist() == [0.0, 5.0]
    assert action_of(frozenset("qx"), low, high) is None
    with pytest.raises(TeacherError, match="there are keys for 8"):
        action_of(frozenset(), np.zeros(9), np.ones(9))


def test_a_key_is_held_until_the_terminal_repeats_it_no_more(terminal):
    keyboard = Keyboard(terminal[1])
    assert not keyboard.held()
    os.write(terminal[0], b"d")
    assert keyboard.held(0.01) == {"d"}
    assert keyboard.held() == {"d"}
    assert not keyboard.held(0.6)
    keyboard.close()


def test_a_person_answers_what_was_seen_a_reaction_ago(terminal):
    screen = io.StringIO()
    taught = KeyTeacher(terminal[1], reaction=0.05, pace=0.02, screen=screen)
    envs = Tracking(1)
    envs.render_mode = None
    envs.reset(seed=0)
    taught.start(envs, 0)
    shown, answered = [], []
    for step in range(12):
        shown.append(time.monotonic())
        if step >= 4:
            os.write(terminal[0], b"d")
        answers = taught.answer(Questions(step, np.array([step % 2 == 0]), np.zeros((1, 1))))
        now = time.monotonic()
        for number, action in zip(answers.steps, answers.actions, strict=True):
            assert now - shown[number] >= 0.05
            assert action.tolist() == [2.0]
            answered.append(number)
    taught.close()
    assert now - shown[0] >= 11 * 0.02  # the pace of the task
    assert answered
    assert all(number % 2 == 0 for number in answered)
    assert answered == sorted(set(answered))
    assert "ASKED" in screen.getvalue()


def test_keys_need_a_terminal():
    read, write = os.pipe()
    with pytest.raises(TeacherError, match="the standard input is no terminal"):
        Keyboard(read)
    os.close(read)
    os.close(write)


def test_a_picture_becomes_two_pixels_for_each_character():
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[:2] = (255, 0, 0)
    lines = terminal_picture(picture, 2).split("\n")
    assert len(lines) == 1
    assert lines[0].count("38;2;255;0;0;48;2;0;0;0m") == 2

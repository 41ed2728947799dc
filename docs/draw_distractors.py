"""Draws the gallery of pixel distractors: python docs/draw_distractors.py"""

import tempfile
from pathlib import Path

import gymnasium
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.distractors import DistractorOptions
from deepkoco.envs.film import write_clip
from deepkoco.envs.task_factory import TaskConfig, make_task_factory

IMAGE = Path(__file__).parent / "images" / "distractors.png"
TASK = TaskConfig("pendulum", "deepkoco/RodPendulum-v0", kwargs={"action_units": "physical"})
ROWS = (
    "copies",
    "background",
    "video",
    "colour",
    "camera",
    "sensor_noise",
    "background+copies+colour+camera+sensor_noise",
)
INTENSITIES = (0.1, 0.3, 1.0)
STEPS = (0, 15, 30)


def frames(distractors: str, intensity: float, videos: str, split: str = "train") -> list[np.ndarray]:
    """Frames of one episode at the chosen steps."""
    options = DistractorOptions(intensity, videos=videos)
    envs = make_task_factory(TASK, distractors, "images", options, split)(1, 0)
    seen = [envs.reset(seed=3)[0][0]]
    for k in range(max(STEPS)):
        seen.append(envs.step(np.full((1, 1), 2.0 * np.sin(0.2 * k), np.float32))[0][0])
    return [seen[k] for k in STEPS]


def film_arm(folder: Path) -> None:
    """Two short videos of another task, for the row of videos."""
    for seed in (0, 1):
        env = gymnasium.make("deepkoco/Manipulator-v0", render_mode="rgb_array", render_size=128)
        env.reset(seed=seed)
        env.action_space.seed(seed)
        pictures = []
        for _ in range(60):
            env.step(env.action_space.sample())
            pictures.append(255 - np.asarray(env.render()))
        write_clip(folder / f"arm_{seed}.webm", pictures, 20.0)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        film_arm(Path(folder))
        columns = [(i, split) for i in INTENSITIES for split in ("train", "evaluation")]
        figure, axes = plt.subplots(
            len(ROWS), len(columns), figsize=(15, 6.2), gridspec_kw={"wspace": 0.03, "hspace": 0.06}
        )
        for row, name in zip(axes, ROWS, strict=True):
            for axis, (intensity, split) in zip(row, columns, strict=True):
                strip = np.concatenate(frames(name, intensity, folder, split), 1)
                axis.imshow(strip, interpolation="nearest")
                axis.set(xticks=[], yticks=[])
            row[0].set_ylabel(name.replace("+", "+\n"), fontsize=8, rotation=0, ha="right", va="center")
        for axis, (intensity, split) in zip(axes[0], columns, strict=True):
            axis.set_title(f"intensity {intensity:g}, {split}", fontsize=9)
        figure.savefig(IMAGE, dpi=80, bbox_inches="tight")


if __name__ == "__main__":
    main()

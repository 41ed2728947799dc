"""Settings of the baselines."""

import dataclasses

import pytest
from omegaconf import OmegaConf

from baselines.config import BaselineConfigError, DbcConfig, DeepMdpConfig, SacConfig
from baselines.registry import BASELINES, baseline
from deepkoco.agent.config import flatten


@pytest.mark.parametrize("name", list(BASELINES))
def test_defaults_pass_and_carry_their_name(name):
    config = BASELINES[name].settings()
    config.check()
    assert config.name == name
    assert config.total_episodes == 400
    # Hydra makes lists of tuples.
    given = OmegaConf.to_object(OmegaConf.structured(type(config)))
    assert isinstance(given, type(config))
    assert flatten(dataclasses.asdict(given)) == flatten(dataclasses.asdict(config))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (SacConfig(batch=0), "batch = 0; give a value above 0"),
        (SacConfig(reward_scale=0.0), r"reward_scale = 0.0; give a value above 0"),
        (SacConfig(discount=1.0), r"discount = 1.0; give a value in \[0, 1\)"),
        (SacConfig(target_rate=0.0), r"target_rate = 0.0; give a value in \(0, 1\]"),
        (SacConfig(evaluation_episodes=-1), "evaluation_episodes = -1"),
        (SacConfig(log_sigma_min=3.0), "log_sigma_min = 3.0 is not below"),
        (SacConfig(convolution_strides=(2, 1)), "one stride for each convolution"),
        (SacConfig(encoder_hidden=(90, 0)), "encoder_hidden = "),
        (DbcConfig(variant="thesis"), 'variant = "thesis"; choose one of code, paper'),
        (DbcConfig(bisimulation_weight=-1.0), "bisimulation_weight"),
        (DeepMdpConfig(transition="none"), "choose one of deterministic, probabilistic, ensemble"),
        (DeepMdpConfig(decoder="none"), "choose one of pixel, identity"),
        (DeepMdpConfig(model_learning_rate=0.0), "model_learning_rate"),
    ],
)
def test_a_wrong_value_is_named(config, message):
    with pytest.raises(BaselineConfigError, match=message):
        config.check()


def test_an_unknown_baseline_is_named():
    with pytest.raises(
        BaselineConfigError, match='name = "td3"; choose one of sac, sac_shared, deepmdp, dbc'
    ):
        baseline("td3")


def test_every_field_has_its_docstring():
    import ast
    import inspect

    import baselines.config as module

    tree = ast.parse(inspect.getsource(module))
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and dataclasses.is_dataclass(getattr(module, node.name)):
            for field, after in zip(node.body, node.body[1:], strict=False):
                if isinstance(field, ast.AnnAssign):
                    assert isinstance(after, ast.Expr), f"{node.name}.{ast.unparse(field.target)}"

"""What a YAML file beside a model overrides."""

import pytest

from deepkoco.systems.trees import TreeError
from tests.systems.trees.test_tree_reading import mjcf, read, urdf


def with_settings(tmp_path, yaml, model=None, name="robot.urdf"):
    (tmp_path / "robot.parameters.yaml").write_text(yaml)
    return read(tmp_path, urdf() if model is None else model, name)


def test_values_priors_noise_and_place_of_the_payload_come_from_the_file(tmp_path):
    system = with_settings(
        tmp_path,
        """
        parameters:
          mass(arm): 1.2
          "com_*(arm)": {prior_sd: 0.004}
          damping(hinge): {value: 0.3, prior_sd: 0.01}
        noise: {"q_*": 0.0015}
        zero_sd: {q_hinge: 0.02}
        payload: arm
        """,
    )
    assert system.parameter("mass(arm)").value == 1.2
    assert system.parameter("com_x(arm)").prior_sd == 0.004
    assert (system.parameter("damping(hinge)").value, system.parameter("damping(hinge)").prior_sd) == (
        0.3,
        0.01,
    )
    assert (system.measurements[0].noise_sd, system.measurements[0].zero_sd) == (0.0015, 0.02)


def test_servos_turn_loads_into_goals(tmp_path):
    system = with_settings(tmp_path, 'servos: {"*": {kp: 20, kv: 0.5, force: 3}}')
    (command,) = system.commands
    assert (command.unit, command.default) == ("rad", None)
    assert system.parameter("kp(hinge)").value == 20.0
    assert system.load_scales == (3.0,)


@pytest.mark.parametrize(
    ("yaml", "named"),
    [
        ("parametrs: {}", 'unknown key "parametrs"; did you mean parameters'),
        ("parameters: {mass(am): 1}", 'there is no parameter "mass(am)"; did you mean mass(arm)'),
        ("parameters: {mass(arm): heavy}", "expected a number, got 'heavy'"),
        ("parameters: {mass(arm): {sd: 1}}", 'unknown "sd"'),
        ("parameters: {damping(hinge): -1}", "is below 0"),
        ("noise: {q_elbow: 1}", 'no measurement "q_elbow"'),
        ("servos: {hinge: {kv: 1}}", "kp is needed"),
        ("payload: hand", 'no place "hand"'),
    ],
)
def test_a_wrong_entry_is_refused_with_the_file_and_the_entry(yaml, named, tmp_path):
    with pytest.raises(TreeError) as error:
        with_settings(tmp_path, yaml)
    assert str(error.value).startswith(str(tmp_path / "robot.parameters.yaml"))
    assert named in str(error.value)


def test_servos_are_refused_where_the_model_has_actuators(tmp_path):
    model = mjcf(
        '<body name="arm"><joint name="hinge" axis="0 1 0"/><geom size=".1" pos=".1 0 0"/></body>',
        '<actuator><motor name="m" joint="hinge"/></actuator>',
    )
    with pytest.raises(TreeError, match="actuators of its own"):
        with_settings(tmp_path, "servos: {hinge: {kp: 1}}", model, "robot.xml")

"""What a YAML may say: every mistake ends in one line that names it and, where one is near, the right word."""

from pathlib import Path

import pytest
import yaml
from liberobot import CONFIG, TRAINING_MOTIONS
from requirements import BACKEND_NAMES, BACKEND_PARAMS

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import load_config, make_config, named_config, validated_config
from imolo.config.reading import MOVED
from imolo.contracts.backend import BackendPlugin
from imolo.contracts.registry import BACKENDS
from imolo.errors import BackendNotFoundError, ConfigError, ImoloError

CONFIGS = Path(__file__).parents[2] / "configs"
GOOD = "backend: {name: mujoco}\n"


def load(tmp_path: Path, text: str) -> ExperimentConfig:
    path = tmp_path / "experiment.yaml"
    path.write_text(text, encoding="utf-8")
    return load_config(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sed: 2\n", "unknown key 'sed'; did you mean 'seed'?"),
        ("simulation: {timestp: 1.0e-4}\n", "unknown key 'simulation.timestp'; did you mean 'timestep'?"),
        (
            "simulation: {actuators: {tube_lenght: 1}}\n",
            "unknown key 'simulation.actuators.tube_lenght'; did you mean 'tube_length'?",
        ),
        ("campaign: {nonsense: 1}\n", "(known: balls, duration, learning_throws, parallel, tail)"),
        ("seed: many\n", "'seed' is 'many': Input should be a valid integer"),
        ("seed: -1\n", "'seed' is -1: Input should be greater than or equal to 0"),
        ("campaign: 5\n", "'campaign' is 5: Input should be a valid dictionary"),
        ("campaign: {balls: 0}\n", "'campaign.balls' is 0"),
        ("simulation: {timestep: .nan}\n", "'simulation.timestep' is nan: Input should be"),
        ("robot: {sole: round}\n", "'robot.sole' is 'round': Input should be 'semicircular' or 'flat'"),
        ("simulation: {actuators: {rest_pressure: [0, 0]}}\n", "should have at least 8 items"),
        ("simulation: {thrower: {hold_time: [0.2, 0.1]}}\n", "is not (shortest, longest)"),
        ("motion: {swing_phase: 7}\n", "swing_phase is 7; give 1 to 3"),
        ("motion: {phases: [{target: [0], until: 1}]}\n", "swing_phase is 3; give 1 to 1"),
        (
            "methods: {paper: {grid: {parameters: {v: {start: 0, stop: 1, step: 1}}}}}\n",
            "the grid is over t_w, k, v, the motion has k, t_w; give each an axis",
        ),
        ("training: {motions: [[2.0, 0.3]]}\n", "k is 2; give -1 to 1"),
        ("training: {motions: [[0.3]]}\n", "theta is (0.3,); give 2 values: k, t_w"),
        ("training: {motions: []}\n", "'training.motions' is []: Tuple should have at least 1 item"),
        ("methods: {}\n", "'methods' is {}: Dictionary should have at least 1 item"),
        ("simulation: {disturbance: {profile: none, joint_angle: 0.1}}\n", "use `profile: custom` to choose"),
        ("1: 2\n", "'1' is 1: Keys should be strings"),
    ],
)
def test_wrong_key_or_value_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, GOOD + text)
    assert message in str(caught.value)
    assert "experiment.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no settings; it needs at least a line such as `backend: {name: mujoco}`"),
        ("# nothing but a comment\n", "holds no settings"),
        ("- 1\n- 2\n", "holds no settings"),
        ("seed: 1\n", "'backend' is missing"),
        ("backend: {}\n", "'backend.name' is missing"),
        ("backend: mujoco\n", "'backend' is 'mujoco'"),
        ("backend: [\n", "is not YAML"),
        ("a: b: c\n", "is not YAML"),
        ("\x00", "is not YAML"),
        ("!!python/object:os.system {}\n", "is not YAML"),
    ],
)
def test_file_without_a_usable_config_says_what_it_lacks(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_file_that_is_no_text_is_not_yaml(tmp_path: Path) -> None:
    path = tmp_path / "experiment.yaml"
    path.write_bytes(b"\xff\xfe\x80")
    with pytest.raises(ConfigError, match="is not YAML"):
        load_config(path)


def test_name_that_is_no_text_is_an_unknown_backend() -> None:
    with pytest.raises(BackendNotFoundError, match="unknown backend"):
        named_config("mujoc\udcfc")


@pytest.mark.parametrize(("place", "reason"), [("gone.yaml", "No such file"), ("", "Is a directory")])
def test_file_that_cannot_be_read_is_named(tmp_path: Path, place: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=f"cannot read the config {tmp_path / place}: {reason}"):
        load_config(tmp_path / place)


@pytest.mark.parametrize("value", ["none", "5", ""])
def test_disturbance_that_is_no_section_is_named(tmp_path: Path, value: str) -> None:
    with pytest.raises(ConfigError, match=r"simulation\.disturbance"):
        load(tmp_path, f"{GOOD}simulation: {{disturbance: {value}}}\n")


def test_date_is_a_text(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'seed' is '2020-13-45': Input should be a valid integer"):
        load(tmp_path, GOOD + "seed: 2020-13-45\n")


@pytest.mark.parametrize(("key", "largest"), [("seed", 2**63 - 1), ("balls", 2**31 - 1)])
def test_numbers_are_those_that_a_message_holds(tmp_path: Path, key: str, largest: int) -> None:
    def config(number: int) -> Path:
        text = f"seed: {number}" if key == "seed" else f"campaign: {{balls: {number}}}"
        (tmp_path / "config.yaml").write_text(f"backend: {{name: mujoco}}\n{text}\n", encoding="utf-8")
        return tmp_path / "config.yaml"

    chosen = load_config(config(largest))
    assert largest in (chosen.seed, chosen.campaign.balls)
    with pytest.raises(ConfigError, match=f"{key}' is {largest + 1}: Input should be less than"):
        load_config(config(largest + 1))


def test_wrong_key_of_a_method_has_a_hint_too(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="did you mean 'forward_model'"):
        load(tmp_path, GOOD + "methods: {paper: {forward_modle: {}}}\n")


@pytest.mark.parametrize(
    ("simulation", "message"),
    [
        ("{timestep: 0.5}", "less than or equal to 0.005"),
        ("{timestep: 2.0e-3}", "sensor_rate 1000 Hz is more than one message"),
        ("{mocap: {rate: 20000}}", "mocap.rate 20000 Hz is more than one message"),
        ("{actuators: {valve_time_constant: 5.0e-5}}", "valve_time_constant 5e-05 s cannot be integrated"),
    ],
)
def test_steps_that_cannot_work_are_refused(tmp_path: Path, simulation: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, f"{GOOD}simulation: {simulation}\n")


# Backends.


@pytest.mark.parametrize("name", BACKEND_PARAMS)
def test_required_engines_are_registered_and_ready(name: str) -> None:
    assert name in BACKENDS.names()
    assert BACKENDS.status(name).problem == ""


def test_backends_are_in_alphabetical_order() -> None:
    assert BACKENDS.names() == sorted(BACKENDS.names())


@pytest.mark.parametrize("name", BACKEND_PARAMS)
def test_plugin_has_a_line_of_summary_and_options_with_defaults(name: str) -> None:
    plugin = BACKENDS.load(name)
    assert isinstance(plugin, BackendPlugin)
    assert plugin.summary
    assert "\n" not in plugin.summary
    assert plugin.options().model_dump() == plugin.options.model_validate({}).model_dump()


def test_unknown_backend_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(BackendNotFoundError, match=r"unknown backend 'mujco'; did you mean 'mujoco'.*registered: dart"):
        load(tmp_path, "backend: {name: mujco}\n")


def test_unknown_option_of_a_backend_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"backend 'mujoco': unknown key 'itegrator'; did you mean 'integrator'\?"):
        load(tmp_path, "backend: {name: mujoco, itegrator: euler}\n")


def test_option_of_one_backend_is_unknown_to_another(tmp_path: Path) -> None:
    load(tmp_path, "backend: {name: dart, collision_detector: fcl}\n")
    with pytest.raises(ConfigError, match="backend 'mujoco': unknown key 'collision_detector'"):
        load(tmp_path, "backend: {name: mujoco, collision_detector: fcl}\n")


# Robots, tasks and planners.


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("robot: {name: libero}\n", r"unknown robot 'libero'; did you mean 'liberobot'\?; registered: .*liberobot"),
        ("task: {name: hti}\n", r"unknown task 'hti'; did you mean 'hit'\?; registered: .*hit"),
        (
            "methods: {paper: {controller: {name: imol}}}\n",
            r"unknown planner 'imol'; did you mean 'imolo'\?; registered: .*imolo",
        ),
    ],
)
def test_unknown_plug_in_is_refused_with_the_nearest_name(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BackendNotFoundError, match=message):
        load(tmp_path, GOOD + text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("task: {name: hit, sped: 1}\n", "task 'hit': unknown key 'sped'"),
        ("methods: {paper: {controller: {name: imolo, sped: 1}}}\n", "method 'paper' 'imolo': unknown key 'sped'"),
        ("robot: {name: liberobot, sols: flat}\n", "unknown key 'robot.sols'; did you mean 'sole'"),
    ],
)
def test_unknown_option_of_a_plug_in_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(tmp_path, GOOD + text)


def test_config_that_names_no_robot_is_of_the_default_one(tmp_path: Path) -> None:
    assert load(tmp_path, GOOD) == load(tmp_path, GOOD + "robot: {name: liberobot}\n") == CONFIG


def test_motion_of_another_number_of_channels_is_refused_with_both_numbers(tmp_path: Path) -> None:
    phases = "phases: [{target: [0, 0], until: 0.1}, {target: [1, 0]}, {target: [0, 0], until: 1.2}]"
    k = "{name: k, phase: 1, direction: [0, 1], range: [0.0, 1.0]}"
    varied = f"varied: [{k}, {{name: t_w, unit: s, phase: 2}}]"
    motions = "training: {motions: [[0.5, 0.3]]}"
    text = f"{GOOD}motion: {{{phases}, {varied}}}\n{motions}\n"
    with pytest.raises(ConfigError, match="commands 2 channels, the actuators have 8; give every phase 8 targets"):
        load(tmp_path, text)


@pytest.mark.parametrize("key", MOVED)
def test_key_of_an_earlier_version_is_refused_with_its_new_place(tmp_path: Path, key: str) -> None:
    section, name = key.split(".")
    text = {
        "grid": "methods: {paper: {grid: {%s: 1}}}",
        "hit": "methods: {paper: {planner: {hit: {%s: 1}}}}",
    }.get(section, section + ": {%s: 1}")
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, f"{GOOD}{text % name}\n")
    assert f"{key}'; it is now {MOVED[key]}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_that_a_method_leaves_out_are_those_of_the_first_one(tmp_path: Path) -> None:
    config = load(tmp_path, GOOD + "methods: {mine: {planner: {update: false}}}\n")
    assert list(config.methods) == ["mine"]
    paper = CONFIG.methods["paper"]
    expected = paper.model_copy(update={"planner": paper.planner.model_copy(update={"update": False})})
    assert config.methods["mine"] == expected


def test_resolved_config_needs_no_backend_to_be_read() -> None:
    content = CONFIG.model_dump(mode="json")
    content["backend"] = {"name": "not here"}
    assert validated_config(content, "saved").backend.name == "not here"
    with pytest.raises(BackendNotFoundError, match="unknown backend 'not here'"):
        make_config(content)


@pytest.mark.parametrize("content", [[], {}, {"robot": "liberobot"}])
def test_resolved_config_without_a_robot_says_so(content: object) -> None:
    with pytest.raises(ConfigError, match="saved: it names no robot"):
        validated_config(content, "saved")


# The configs that come with it.


def test_shipped_configs_differ_in_the_backend_alone() -> None:
    contents = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in CONFIGS.glob("*.yaml")}
    assert set(contents) == {*BACKEND_NAMES, "hardware"}
    assert {name: content.pop("backend") for name, content in contents.items()} == {n: {"name": n} for n in contents}
    assert all(content == contents["mujoco"] for content in contents.values())


@pytest.mark.parametrize("name", BACKEND_PARAMS)
def test_shipped_config_is_the_experiment_of_the_paper_and_what_the_backends_name_stands_for(name: str) -> None:
    config = load_config(CONFIGS / f"{name}.yaml")
    assert config == named_config(name)
    assert config.training.motions == TRAINING_MOTIONS
    assert config.campaign.balls == 20
    assert config.campaign.learning_throws == 10
    assert config.simulation.timestep == 1e-4
    assert config.methods["paper"] == CONFIG.methods["paper"]


def test_resolved_config_is_read_back_as_it_was(tmp_path: Path) -> None:
    config = load_config(CONFIGS / "mujoco.yaml")
    again = load(tmp_path, yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False))
    assert again == config
    assert again.digest() == config.digest()


def test_digest_tells_configs_apart() -> None:
    config = load_config(CONFIGS / "mujoco.yaml")
    assert config.digest() != config.model_copy(update={"seed": 2}).digest()


def test_every_error_of_ours_is_caught_as_one() -> None:
    assert issubclass(ConfigError, ImoloError)
    assert issubclass(BackendNotFoundError, ImoloError)

"""From YAML, or from the name of a backend, to a checked config: defaults of the robot, options of the plug-ins."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from imolo.config.experiment import ExperimentConfig, PluginConfig, RobotConfig
from imolo.config.links import with_links
from imolo.config.model import Model
from imolo.config.reading import check_model, read_yaml
from imolo.contracts.backend import Backend, BackendPlugin
from imolo.contracts.registry import BACKENDS, PLANNERS, ROBOTS, TASKS, default_robot
from imolo.contracts.robot import Body
from imolo.contracts.task import Task, TaskPlugin
from imolo.errors import BackendNotFoundError, ConfigError

LEAST = "it needs at least a line such as `backend: {name: mujoco}`"


def load_config(path: Path) -> ExperimentConfig:
    """Read and check a YAML file.

    Raises:
        ConfigError: The file cannot be read, a key is unknown, or a value is out of range.
        BackendNotFoundError: Its backend, robot, task or planner is unknown or not installed.
    """
    return make_config(read_yaml(path, LEAST), str(path))


def is_config_file(text: str) -> bool:
    """Return whether what stands where a command takes a config is the path of a file, and not a backend's name."""
    path = Path(text)
    return path.suffix in (".yaml", ".yml") or len(path.parts) != 1 or (path.is_file() and text not in BACKENDS.names())


def named_config(text: str, **settings: Any) -> ExperimentConfig:
    """Return the config that a command is given.

    Args:
        text: The path of a YAML, or the name of a backend, which stands for all defaults on it.
        settings: What other sections are given beside a name.

    Raises:
        ConfigError: The file cannot be read, a key is unknown, or a value is out of range.
        BackendNotFoundError: A plug-in is unknown or not installed.
    """
    if is_config_file(text):
        return load_config(Path(text))
    BACKENDS.status(text)  # which need not even be a text, and no settings hold it then
    return config_for(text, **settings)


def make_config(content: Mapping[str, Any], where: str = "the config") -> ExperimentConfig:
    """Check settings, after what the robot says of those that are not given.

    Args:
        content: As a YAML file would have it; the robot is the default one if it names none.
        where: What to call it in errors.

    Raises:
        ConfigError: A key is unknown, or a value is out of range.
        BackendNotFoundError: A plug-in is unknown or not installed.
    """
    chosen = content.get("robot", {})
    name = chosen.get("name") if isinstance(chosen, Mapping) else None
    robot = ROBOTS.load(str(name) if name is not None else default_robot())
    content = merged(robot_defaults(str(name or default_robot())), content)
    config = check_model(content, robot.config, where)
    backend_options(config)
    task_options(config)
    for method, settings in config.methods.items():
        plugin_options(settings.controller, PLANNERS.load(settings.controller.name).options, f"method {method!r}")
    return config


def validated_config(content: Any, where: str) -> ExperimentConfig:
    """Check the settings of a resolved config; its backend need not be installed here.

    Raises:
        ConfigError: A key is unknown, or a value is out of range.
        BackendNotFoundError: Its robot is not installed.
    """
    if not isinstance(content, Mapping) or not isinstance(content.get("robot"), Mapping):
        raise ConfigError(f"{where}: it names no robot")
    robot = ROBOTS.load(str(content["robot"].get("name")))
    return check_model(content, robot.config, where)


def config_for(backend: str, **settings: Any) -> ExperimentConfig:
    """Return the default config on a backend, with what other sections are given."""
    return make_config({"backend": {"name": backend}, **settings})


def merged(defaults: Mapping[str, Any], content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content with what it leaves out from the defaults.

    A method that is not among the defaults is the first of them, changed; methods that are not named are left out.
    """
    result = {**defaults, **content}
    for key, value in content.items():
        known = defaults.get(key)
        if not (isinstance(value, Mapping) and isinstance(known, Mapping)):
            continue
        if key == "methods":
            first = next(iter(known.values()))
            result[key] = {
                name: merged(known.get(name, first), method) if isinstance(method, Mapping) else method
                for name, method in value.items()
            }
        elif not (key == "forward_model" and "estimator" in value):  # whose parameters are not another's
            result[key] = merged(known, value)
    return result


@cache
def _defaults_of(robot: str) -> Mapping[str, Any]:
    defaults = ROBOTS.load(robot).defaults
    content = read_yaml(defaults, "it is to hold the defaults of a robot") if isinstance(defaults, Path) else defaults
    return merged(content, {"robot": {"name": robot}})


def robot_defaults(robot: str) -> Mapping[str, Any]:
    """Return what a config of a robot need not say.

    Raises:
        BackendNotFoundError: The robot is unknown.
    """
    return _defaults_of(robot)


def plugin_options(chosen: PluginConfig, options: type[Model], what: str) -> Model:
    """Return the validated options of a plug-in.

    Raises:
        ConfigError: An option is unknown or out of range.
    """
    return check_model(chosen.model_extra or {}, options, f"{what} {chosen.name!r}")


def backend_options(config: ExperimentConfig) -> Model:
    """Return the validated options of a config's backend."""
    return plugin_options(config.backend, BACKENDS.load(config.backend.name).options, "backend")


def task_options(config: ExperimentConfig) -> Model:
    """Return the validated options of a config's task."""
    return plugin_options(config.task, TASKS.load(config.task.name).options, "task")


def create_backend(config: ExperimentConfig) -> Backend:
    """Make the backend of a config for one trial."""
    return backend_plugin(config).create(config, backend_options(config))


def backend_plugin(config: ExperimentConfig) -> BackendPlugin:
    """Return the backend of a config."""
    return BACKENDS.load(config.backend.name)


def task_plugin(config: ExperimentConfig) -> TaskPlugin:
    """Return the task of a config."""
    return TASKS.load(config.task.name)


def create_task(config: ExperimentConfig) -> Task:
    """Make the task of a config."""
    return task_plugin(config).create(config, task_options(config), body_of(config.robot))


@lru_cache(maxsize=64)
def body_of(robot: RobotConfig) -> Body:
    """Return the body of a robot under its options, its links as the config has them.

    Raises:
        BackendNotFoundError: The robot is unknown.
        BackendError: Its model cannot be used.
        ConfigError: A link that is to differ is not there.
    """
    body = ROBOTS.load(robot.name).body(robot.model_copy(update={"links": {}}))
    return replace(body, urdf=with_links(body.urdf, robot.links)) if robot.links else body


def known_body(name: str) -> Body | None:
    """Return the body of a robot under its default options; None where it is not installed."""
    try:
        robot = ROBOTS.load(name)
    except BackendNotFoundError:
        return None
    options = robot_defaults(name).get("robot", {"name": name})
    kind: Any = robot.config.model_fields["robot"].annotation
    return body_of(kind.model_validate(options))

"""Which backends are installed: the entry points of the group `imolo.backends`, our own and those of others."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points

from imolo.contracts.backend import BackendPlugin, RobotDescription
from imolo.errors import BackendNotFoundError, did_you_mean

GROUP = "imolo.backends"


@dataclass(frozen=True)
class BackendStatus:
    """Whether a backend can be used here.

    Attributes:
        name: Its public name.
        plugin: What it provides; None where something is missing.
        problem: What is missing and how to get it; empty where nothing is.
    """

    name: str
    plugin: BackendPlugin | None
    problem: str


def backend_names() -> list[str]:
    """Return the names of all registered backends, usable or not, in alphabetical order."""
    return sorted(entry_points(group=GROUP).names)


def backend_status(name: str) -> BackendStatus:
    """Load a backend and say whether it can be used.

    Raises:
        BackendNotFoundError: No backend of that name is registered.
    """
    if name not in backend_names():
        raise BackendNotFoundError(
            f"unknown backend {name!r}{did_you_mean(name, backend_names())}; registered: {', '.join(backend_names())}"
        )
    entry_point = entry_points(group=GROUP)[name]
    try:
        return BackendStatus(name, entry_point.load(), "")
    except ImportError as error:
        return BackendStatus(name, None, _how_to_install(entry_point, error))


def load_backend(name: str) -> BackendPlugin:
    """Return the plugin of a backend.

    Raises:
        BackendNotFoundError: It is not registered, or what it needs is not installed.
    """
    status = backend_status(name)
    if status.plugin is None:
        raise BackendNotFoundError(f"backend {name!r} cannot be used: {status.problem}")
    return status.plugin


def ready_simulations() -> list[str]:
    """Return the names of the simulated backends that are ready, in alphabetical order.

    Raises:
        BackendNotFoundError: There are none.
    """
    plugins = {name: backend_status(name).plugin for name in backend_names()}
    ready = [name for name, plugin in plugins.items() if plugin is not None and plugin.simulated]
    if not ready:
        raise BackendNotFoundError("no backend is ready; `imolo backends` says what to install")
    return ready


def describe_robot(name: str) -> RobotDescription | None:
    """Return what a robot looks like, from any backend that is ready and has it; None if none has."""
    for backend in backend_names():
        plugin = backend_status(backend).plugin
        if plugin is not None and plugin.robot is not None and plugin.robot.name == name:
            return plugin.robot
    return None


def _how_to_install(entry_point: EntryPoint, error: ImportError) -> str:
    extras = entry_point.dist.metadata.get_all("Provides-Extra") or [] if entry_point.dist else []
    # An optional dependency carries the name of the backend it brings; a backend without one says itself what to do.
    if entry_point.dist is None or entry_point.name not in extras:
        return str(error)
    return f"{error}; install it with: pip install '{entry_point.dist.name}[{entry_point.name}]'"

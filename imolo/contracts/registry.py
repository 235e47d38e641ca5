"""Which plug-ins are installed: the entry points of our groups, our own and those of others."""

import sys
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from imolo.contracts.unloaded import summary_unloaded
from imolo.errors import BackendNotFoundError, did_you_mean
from imolo.machine.extras import how_to_install

# They import what takes a second, and a list of plug-ins does without.
if TYPE_CHECKING:
    from imolo.contracts.backend import BackendPlugin
    from imolo.contracts.planner import PlannerPlugin
    from imolo.contracts.robot import Robot
    from imolo.contracts.task import TaskPlugin

Plugin = TypeVar("Plugin")

DEFAULT_ROBOT = "imolo.default_robot"
"""Group whose one entry point names the robot of a config that names none."""


@dataclass(frozen=True)
class PluginStatus(Generic[Plugin]):
    """Whether a plug-in can be used here.

    Attributes:
        name: Its public name.
        plugin: What it provides; None where something is missing.
        problem: What is missing and how to get it; empty where nothing is.
    """

    name: str
    plugin: Plugin | None
    problem: str


class Registry(Generic[Plugin]):
    """The plug-ins of one kind."""

    def __init__(self, kind: str, group: str) -> None:
        """Look into a group of entry points.

        Args:
            kind: For people, such as "backend".
            group: Name of the group.
        """
        self.kind, self.group = kind, group

    def names(self) -> list[str]:
        """Return the names of all registered plug-ins, usable or not, in alphabetical order."""
        return sorted(self._entry_points().names)

    def status(self, name: str) -> PluginStatus[Plugin]:
        """Load a plug-in and say whether it can be used.

        Raises:
            BackendNotFoundError: None of that name is registered.
        """
        names = self.names()
        if name not in names:
            raise BackendNotFoundError(
                f"unknown {self.kind} {name!r}{did_you_mean(name, names)}; registered: {', '.join(names)}"
            )
        entry_point = self._entry_points()[name]
        try:
            return PluginStatus(name, entry_point.load(), "")
        except ImportError as error:
            return PluginStatus(name, None, _how_to_get(entry_point, error))

    def about(self, name: str) -> tuple[str, str]:
        """Return the one line that a plug-in says of itself, and what is missing, empty where nothing is.

        It is loaded only where its source does not tell, for engines take seconds.
        """
        summary = summary_unloaded(self._entry_points()[name])
        if summary is not None:
            return summary, ""
        status: PluginStatus[Any] = self.status(name)
        return (status.plugin.summary if status.plugin is not None else ""), status.problem

    def load(self, name: str) -> Plugin:
        """Return a plug-in.

        Raises:
            BackendNotFoundError: It is not registered, or what it needs is not installed.
        """
        status = self.status(name)
        if status.plugin is None:
            raise BackendNotFoundError(f"{self.kind} {name!r} cannot be used: {status.problem}")
        return status.plugin

    def _entry_points(self) -> EntryPoints:
        return _installed(self.group, tuple(sys.path))


@lru_cache
def _installed(group: str, path: tuple[str, ...]) -> EntryPoints:
    """Return the entry points on a path; to read them anew for each question took a fifth of the time of a trial."""
    return entry_points(group=group)


BACKENDS: "Registry[BackendPlugin]" = Registry("backend", "imolo.backends")
ROBOTS: "Registry[Robot]" = Registry("robot", "imolo.robots")
TASKS: "Registry[TaskPlugin]" = Registry("task", "imolo.tasks")
PLANNERS: "Registry[PlannerPlugin]" = Registry("planner", "imolo.planners")


@cache
def default_robot() -> str:
    """Return the name of the robot of a config that names none."""
    return next(iter(sorted(entry_points(group=DEFAULT_ROBOT).names)), "")


def ready_simulations() -> list[str]:
    """Return the names of the simulated backends that are ready, in alphabetical order.

    Raises:
        BackendNotFoundError: There are none.
    """
    plugins = {name: BACKENDS.status(name).plugin for name in BACKENDS.names()}
    ready = [name for name, plugin in plugins.items() if plugin is not None and plugin.simulated]
    if not ready:
        raise BackendNotFoundError("no backend is ready; `imolo backends` says what to install")
    return ready


def _how_to_get(entry_point: EntryPoint, error: ImportError) -> str:
    # An optional dependency carries the name of the backend it brings; a backend without one says itself what to do.
    advice = how_to_install(entry_point.name, entry_point.dist.requires or ()) if entry_point.dist else ""
    return f"{error}; {advice}" if advice else str(error)

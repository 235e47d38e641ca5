"""The checks of one backend under some options, by its name or by a config."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from pathlib import Path
from typing import Any

from imolo.config.loading import is_config_file, load_config
from imolo.config.model import Model
from imolo.conformance.check import Check, Outcome, Verdict, run_check
from imolo.contracts.backend import BackendPlugin
from imolo.contracts.provenance import provenance
from imolo.contracts.registry import BACKENDS, ready_simulations
from imolo.errors import ConfigError, did_you_mean


@dataclass(frozen=True)
class Suite:
    """The checks of one backend; it travels to a child process as names and values.

    Attributes:
        label: Under which it is reported: the backend's name, or the name of the config file.
        backend: Name of the backend.
        options: The options that were chosen; all others have their defaults.
    """

    label: str
    backend: str
    options: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def plugin(self) -> BackendPlugin:
        """What the backend's entry point provides."""
        return BACKENDS.load(self.backend)

    @cached_property
    def chosen(self) -> Model:
        """The validated options."""
        return self.plugin.options.model_validate(self.options)

    @cached_property
    def checks(self) -> dict[str, Check]:
        """The checks by name, in the order of the report."""
        return {check.name: check for check in self.plugin.checks(self.chosen)}

    @cached_property
    def is_default(self) -> bool:
        """Whether all options have their defaults, for which alone limitations are declared."""
        return self.chosen == self.plugin.options()

    def run(self, name: str) -> list[Outcome]:
        """Run one check in this process and judge what it measured."""
        return run_check(self.checks[name], self.plugin.limitations, exactly=self.is_default)

    def misplaced(self) -> list[Outcome]:
        """Return a failure for each declared limitation of a check that there is not."""
        return [
            Outcome(
                check,
                "limitations",
                "",
                Verdict.FAIL,
                None,
                f"declares a limitation of {', '.join(map(repr, quantities))}, "
                f"but there is no such check{did_you_mean(check, self.checks)}",
            )
            for limit in self.plugin.limitations
            for check, quantities in limit.quantities.items()
            if check not in self.checks
        ]

    def select(self, only: Sequence[str]) -> list[str]:
        """Return the names of the checks that are named, or whose group is; all where nothing is."""
        return [name for name, check in self.checks.items() if not only or {name, check.group} & set(only)]

    def versions(self) -> dict[str, str]:
        """Return what the plug-in's code is, and the versions of the packages that the extra of its name brings."""
        found = {"plug-in": str(provenance(BACKENDS.group, self.backend))}
        for package in _packages(entry_points(group=BACKENDS.group)[self.backend]):
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                continue
        return found


def suites(arguments: Sequence[str | Suite]) -> list[Suite]:
    """Return what is to be checked.

    Args:
        arguments: Names of backends, paths of configs, and suites; none for every simulated backend that is ready.

    Raises:
        BackendNotFoundError: A backend is unknown or not installed, or none is ready.
        ConfigError: A config cannot be used, or two would be reported under one label.
    """
    chosen = [one if isinstance(one, Suite) else _suite(one) for one in arguments or ready_simulations()]
    labels = [suite.label for suite in chosen]
    for label in labels:
        if labels.count(label) > 1:
            raise ConfigError(f"{label!r} would be reported twice; name each backend once, and configs differently")
    return chosen


def check_names(only: Iterable[str], chosen: Iterable[Suite]) -> None:
    """Raise a ConfigError where something is neither a check nor a group of any of the suites."""
    checks = [check for suite in chosen for check in suite.checks.values()]
    known = list(dict.fromkeys([check.group for check in checks] + [check.name for check in checks]))
    for name in only:
        if name not in known:
            groups = ", ".join(dict.fromkeys(check.group for check in checks))
            raise ConfigError(f"unknown check or group {name!r}{did_you_mean(name, known)}; groups: {groups}")


def _suite(argument: str) -> Suite:
    if not is_config_file(argument):
        BACKENDS.load(argument)
        return Suite(argument, argument)
    config = load_config(Path(argument))
    return Suite(Path(argument).stem, config.backend.name, dict(config.backend.model_extra or {}))


def _packages(entry_point: EntryPoint) -> list[str]:
    requirements = (entry_point.dist.requires if entry_point.dist else None) or []
    mine = re.compile(rf"""extra\s*==\s*['"]{re.escape(entry_point.name)}['"]""")
    names = (re.match(r"[A-Za-z0-9._-]+", requirement) for requirement in requirements if mine.search(requirement))
    return [name.group() for name in names if name]

"""The folder that holds everything of an experiment, and what says how it came about."""

import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml
from matplotlib.figure import Figure
from pydantic import BaseModel

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_options
from imolo.errors import ResultsError
from imolo.messaging.log import LOG_SUFFIX

PACKAGES = (
    "imolo",
    "lcm",
    "numpy",
    "scipy",
    "scikit-learn",
    "filterpy",
    "numba",
    "mujoco-core",
    "pybullet",
    "dartpy",
    "Py3ODE",
)


@dataclass(frozen=True)
class ResultsFolder:
    """Where everything of one experiment lies.

    Attributes:
        path: The folder.
    """

    path: Path

    def prepare(self) -> None:
        """Create the folder.

        Raises:
            ResultsError: It cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            probe = self.path / ".writable"
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise ResultsError(
                f"cannot write results to {self.path}: {error.strerror}; choose another --out"
            ) from error

    def discard_trials(self) -> None:
        """Delete the trials that are there, so that all of them are run anew.

        Raises:
            ResultsError: They cannot be deleted.
        """
        for path in (self.path / "logs").rglob(f"*{LOG_SUFFIX}*"):
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise ResultsError(f"cannot delete {path}: {error.strerror}; choose another --out") from error

    def trials(self) -> int:
        """Return how many complete trials are there."""
        return sum(1 for _ in (self.path / "logs").rglob(f"*{LOG_SUFFIX}"))

    def learning(self, backend: str) -> Path:
        """Return the folder of the logs that a backend learns from."""
        return self.path / "logs" / backend / "learning"

    def hits(self, backend: str, method: str) -> Path:
        """Return the folder of the logs of one method's balls."""
        return self.path / "logs" / backend / method

    def table(self, backend: str, method: str) -> Path:
        """Return the table file of one method."""
        return self.path / "tables" / f"{backend}_{method}.npz"

    @property
    def figures(self) -> Path:
        """Return the folder of the figures."""
        return self.path / "figures"

    def save_config(self, config: ExperimentConfig) -> None:
        """Write the config with every default, the backend's own ones included."""
        path = self.path / "configs" / f"{config.backend.name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        content = config.model_dump(mode="json")
        content["backend"].update(backend_options(config).model_dump(mode="json"))
        path.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")

    def save_figure(self, name: str, figure: Figure) -> Path:
        """Write a figure to a file of this name among the figures, and return the file."""
        path = self.figures / name
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, bbox_inches="tight", facecolor="white")
        return path

    def save_json(self, name: str, content: BaseModel) -> None:
        """Write numbers to a file of this name."""
        (self.path / name).write_text(content.model_dump_json(indent=1) + "\n", encoding="utf-8")


def installed_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found

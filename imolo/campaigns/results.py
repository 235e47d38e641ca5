"""The folder that holds everything of an experiment, and what says how it came about."""

import platform
import shlex
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from pydantic import BaseModel

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_options
from imolo.config.yaml_file import dump_yaml
from imolo.contracts.provenance import arithmetic, commit, provenance
from imolo.contracts.registry import BACKENDS
from imolo.errors import ResultsError
from imolo.machine.files import TEMPORARY, whole_file
from imolo.machine.folder_lock import claim_folder
from imolo.messaging.log import LOG_SUFFIX

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES_SUFFIX = ".samples.npz"
"""Of files with what was seen of training motions that have no logs."""

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


class Origin(BaseModel):
    """How a results folder came about.

    Attributes:
        command: As it was typed; the last one where a campaign went on.
        commit: Of our code, see `imolo.contracts.provenance.commit`.
        version: Of imolo.
        machine: Where it ran, and on what processor.
    """

    command: str
    commit: str
    version: str
    machine: str


@dataclass(frozen=True)
class ResultsFolder:
    """Where everything of one experiment lies.

    Attributes:
        path: The folder.
    """

    path: Path

    def prepare(self) -> None:
        """Create the folder, and keep other programs out of it until this one ends.

        Raises:
            ResultsError: It cannot be written, or another program is at work in it.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            owner = claim_folder(self.path)
        except OSError as error:
            raise ResultsError(
                f"cannot write results to {self.path}: {error.strerror}; choose another --out"
            ) from error
        if owner:
            raise ResultsError(f"{self.path} is in use by {owner}; wait until it ends, or choose another --out")
        for path in self.path.rglob(TEMPORARY):
            path.unlink(missing_ok=True)

    def discard_trials(self) -> None:
        """Delete the trials that are there, so that all of them are run anew.

        Raises:
            ResultsError: They cannot be deleted.
        """
        for path in (path for kind in (LOG_SUFFIX, SAMPLES_SUFFIX) for path in self._trials(f"{kind}*")):
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise ResultsError(f"cannot delete {path}: {error.strerror}; choose another --out") from error

    def trials(self) -> int:
        """Return how many complete trials are there."""
        return sum(1 for _ in self._trials(LOG_SUFFIX))

    def _trials(self, ending: str) -> Iterator[Path]:
        return (self.path / "logs").rglob(f"*{ending}")

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
        """Write the config with every default, the backend's own ones included.

        Raises:
            ResultsError: It cannot be written, as with every file of the folder.
        """
        content = config.model_dump(mode="json")
        content["backend"].update(backend_options(config).model_dump(mode="json"))
        with self.file(f"configs/{config.backend.name}.yaml") as file:
            file.write(dump_yaml(content).encode())

    def save_figure(self, name: str, figure: "Figure", within: str = "figures") -> Path:
        """Write a figure to a file of this name in a folder of this one, and return the file."""
        from imolo.campaigns.appearance import write_figure

        with self.file(f"{within}/{name}") as file:
            write_figure(figure, file, Path(name).suffix[1:])
        return self.path / within / name

    def save_drawing(self, name: str, figure: "Figure", within: str = "figures") -> Path:
        """Write a figure for papers and slides, PNG, and for the report, SVG; return the former."""
        self.save_figure(f"{name}.svg", figure, within)
        return self.save_figure(f"{name}.png", figure, within)

    def save_json(self, name: str, content: BaseModel) -> None:
        """Write numbers to a file of this name."""
        with self.file(name) as file:
            file.write(f"{content.model_dump_json(indent=1)}\n".encode())

    def save_origin(self) -> None:
        """Write how the results came about, when they are all there."""
        self.save_json(
            "origin.json",
            Origin(
                command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
                commit=commit(),
                version=version("imolo"),
                machine=f"{platform.system()} {platform.machine()}, {arithmetic()['processor']}",
            ),
        )

    @contextmanager
    def file(self, name: str) -> Iterator[BinaryIO]:
        """Open a file that is replaced as a whole when the block ends, see `whole_file`."""
        try:
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
            with whole_file(self.path / name) as file:
                yield file
        except OSError as error:
            raise ResultsError(
                f"cannot write {self.path / name}: {error.strerror}; make room or choose another --out"
            ) from error


def installed_versions(backends: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of Python and of all that results depend on, and how the processor computes.

    Args:
        backends: Whose code is named too.
    """
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found | arithmetic() | {f"backend {name}": str(provenance(BACKENDS.group, name)) for name in backends}

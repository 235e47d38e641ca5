"""What another body has learned, as the prior of a forward model: fewer trials are needed on the body itself.

A table that was learned densely in one engine says where the hand goes, but for some millimetres, in another engine or
on the robot. A model with this prior learns these millimetres from the few trials there.
"""

from pathlib import Path

from imolo.errors import ImoloError, TableFileError
from imolo.method.forward_model import ForwardModel, ForwardModelConfig, TrainingData
from imolo.method.motion import MotionTemplate
from imolo.method.table_file import read_table_file

MOST_SAMPLES = 2000  # as many as a process fits in half a minute; half as many leave the hand 1 mm farther off


def fit_forward_model(
    config: ForwardModelConfig, training: TrainingData, robot: str, template: MotionTemplate
) -> ForwardModel:
    """Fit a forward model to samples, upon the prior that its config names, if any.

    Args:
        config: Which regression, and which prior.
        training: Samples of the trials; of more than `MOST_SAMPLES` only every second is used, or every third.
        robot: Name of the robot, that of the prior as well.
        template: What theta changes, in the prior as well.

    Raises:
        TableFileError: The prior cannot be read, or is of another robot or other motions.
        ConfigError: The estimator or one of its parameters is unknown.
    """
    prior = None if config.prior is None else load_prior(Path(config.prior), robot, template)
    training = training.thinned(MOST_SAMPLES)
    return ForwardModel(config, template, prior).fit(training.theta, training.time, training.position)


def load_prior(path: Path, robot: str, template: MotionTemplate) -> ForwardModel:
    """Return the forward model of a table, fitted again.

    Args:
        path: Table file.
        robot: The robot it must be for.
        template: The motions it must be of.

    Raises:
        TableFileError: The file cannot be read, or is of another robot or other motions.
    """
    header, arrays = read_table_file(path)
    try:
        found, engine = header["robot"], header["origin"].get("backend", "?")
        if found != robot:
            raise TableFileError(f"the prior {path} is for robot {found!r}, not {robot!r}; give a table of {robot!r}")
        if type(template).model_validate(header["template"]) != template:
            raise TableFileError(
                f"the prior {path}, learned in {engine!r}, is of other motions (`motion` of the config); learn it again"
            )
        config = ForwardModelConfig.model_validate(header["forward_model"])
        training = TrainingData(*(arrays[f"training_{name}"] for name in ("theta", "time", "position")))
    except (LookupError, AttributeError, TypeError, ValueError, ImoloError) as error:
        if isinstance(error, TableFileError):
            raise
        raise TableFileError(f"the prior {path} does not fit this imolo ({error}); build it again") from error
    return fit_forward_model(config, training, robot, template)


def origin_of(path: Path) -> dict[str, object]:
    """Return what made a prior, to be stored with what is built upon it.

    Raises:
        TableFileError: The file cannot be read.
    """
    header, _ = read_table_file(path)
    return {"path": str(path), **{key: header["origin"].get(key) for key in ("backend", "seed", "config")}}

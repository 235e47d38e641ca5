"""The errors imolo raises: one tree, so that a caller can catch all of them at once."""

from collections.abc import Iterable
from difflib import get_close_matches


class ImoloError(Exception):
    """Base of every error that a user of imolo can cause or meet; the message names the value and the fix."""


class ConfigError(ImoloError):
    """A configuration has an unknown key, a value out of range, or cannot be read."""


class BackendNotFoundError(ImoloError):
    """No backend of that name is installed, or what it needs is missing."""


class BackendError(ImoloError):
    """A backend cannot do what was asked, or does not have the model it was given."""


class DivergenceError(BackendError):
    """The simulated state is no longer finite."""


class TrialVoidError(ImoloError):
    """A trial was broken off and says nothing about the robot; it may be repeated."""


class MessageError(ImoloError):
    """A message holds values that cannot be used."""


class BusError(ImoloError):
    """The message bus cannot be opened, or a log cannot be read or written."""


class FieldError(ImoloError):
    """A message has no such field, or a log no such channel."""


class MissingToolError(ImoloError):
    """A program or an optional package that a command needs is not installed."""


class TrainingDataError(ImoloError):
    """There is no or too little data to learn from."""


class NotTrainedError(ImoloError):
    """A model was asked to predict before it was fitted."""


class TableFileError(ImoloError):
    """A table file is damaged, foreign, of another version or for another robot."""


class IdentificationError(ImoloError):
    """Nothing can be fitted: the recordings, the parameters or the engine do not allow it."""


class WorkerError(ImoloError):
    """The workers that run trials cannot be reached, are of another version, or died too often."""


class ResultsError(ImoloError):
    """A results folder cannot be read or written."""


class NatNetError(ImoloError):
    """A NatNet packet is damaged or unknown, or the motion capture cannot be reached as configured."""


class NatNetVersionError(NatNetError):
    """The motion capture speaks a version of NatNet that is not supported."""


class CalibrationError(ImoloError):
    """The motion capture's frame cannot be tied to the robot's, or a calibration file cannot be used."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint such as `; did you mean 'mujoco'?`, or an empty string where nothing is near."""
    nearest = get_close_matches(name, list(known), n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else ""

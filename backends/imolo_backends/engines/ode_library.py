"""The Open Dynamics Engine, or the way to get it; alone in a module so that it is quickly seen whether it is there."""

try:
    import ode

    ode.HingeJoint  # noqa: B018 - PyPI has another package of this name
except (ImportError, AttributeError) as error:
    raise ImportError(f"{error}; get the Open Dynamics Engine with `make ode` in imolo's source folder") from error

__all__ = ["ode"]

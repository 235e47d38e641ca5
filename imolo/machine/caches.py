"""A place for what numba and matplotlib keep from one program to the next, where there is no home for it."""

import os
import stat
import tempfile
from pathlib import Path

KEEPERS = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR")
"""Environment variables that name the folder of each."""


def provide_caches() -> bool:
    """Let them keep it in a temporary folder of this user's if the home cannot be written, as in a container.

    Without a place they end in errors. Call it before they are imported.

    Returns:
        Whether there is a place now.
    """
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if _may_be_written(Path(cache)):
        return True
    missing = [name for name in KEEPERS if not _may_be_written(Path(os.environ.get(name, "~")))]
    try:
        os.environ |= {name: str(_temporary_folder() / name.lower()) for name in missing}
    except OSError:
        return False
    return True


def _may_be_written(path: Path) -> bool:
    """Tell whether a folder can be written, or made; `~` is what is left where there is no home."""
    while not path.exists() and path != path.parent:
        path = path.parent
    return path.is_absolute() and path.is_dir() and os.access(path, os.W_OK | os.X_OK)


def _temporary_folder() -> Path:
    """Return a folder that stays, and that nobody else can write: what lies in it is run.

    Raises:
        OSError: There is none.
    """
    folder = Path(tempfile.gettempdir()) / f"imolo-caches-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{folder} is not this user's alone")
    return folder

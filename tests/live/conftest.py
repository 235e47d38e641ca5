"""A table that was learned once, and a network of its own for every test that asks for it."""

import fcntl
import os
from collections.abc import Iterator

import pytest
from live_table import COARSE, Learned, learn
from network import namespace

from imolo.config.loading import load_config


@pytest.fixture(scope="session")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Learned:
    # Once for all workers of pytest-xdist, whose folders are below one.
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "learned"
    folder.mkdir(exist_ok=True)
    config_path, table_path = folder / "coarse.yaml", folder / "table.npz"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        config_path.write_text(COARSE, encoding="utf-8")
        config = load_config(config_path)
        if not table_path.exists():
            learn(config, folder, table_path)
    return Learned(config_path, table_path, config)


@pytest.fixture
def network() -> Iterator[None]:
    """Run the test in a namespace of its own."""
    with namespace():
        yield

"""`imolo backends` lists what is installed, and what is missing is told with the way to get it."""

import re
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

import pytest
from command_line import Run, is_one_line_about
from requirements import BACKEND_PARAMS

from imolo.contracts import registry
from imolo.contracts.unloaded import summary_unloaded


@pytest.mark.parametrize("name", BACKEND_PARAMS)
def test_backends_lists_every_engine_as_ready(run: Run, name: str) -> None:
    code, output, errors = run("backends")
    assert (code, errors) == (0, "")
    assert re.search(rf"^{name} +ready +\S", output, flags=re.MULTILINE)


@pytest.fixture
def without_pybullet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make Python find no PyBullet, as where the extra was not installed."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.delitem(sys.modules, "imolo_backends.engines.pybullet_engine", raising=False)


@pytest.mark.usefixtures("without_pybullet")
def test_missing_extra_ends_in_one_line_that_says_how_to_get_it(run: Run) -> None:
    Path("experiment.yaml").write_text("backend: {name: pybullet}\n", encoding="utf-8")
    code, _, errors = run("compare", "experiment.yaml")
    assert code == 2
    assert is_one_line_about(errors, "backend 'pybullet' cannot be used", "pip install 'imolo[pybullet]'")


@pytest.mark.usefixtures("without_pybullet")
def test_missing_extra_leaves_the_other_backends_ready() -> None:
    status = {name: registry.BACKENDS.status(name) for name in ("dart", "mujoco", "pybullet")}
    assert status["pybullet"].plugin is None
    assert status["pybullet"].problem.endswith("install it with: pip install 'imolo[pybullet]'")
    assert (status["mujoco"].problem, status["dart"].problem) == ("", "")


@pytest.mark.usefixtures("without_pybullet")
def test_backends_says_that_an_engine_is_missing(run: Run) -> None:
    code, output, _ = run("backends")
    assert code == 0
    assert re.search(r"^pybullet +missing ", output, flags=re.MULTILINE)
    assert re.search(r"^mujoco +ready ", output, flags=re.MULTILINE)


@pytest.mark.usefixtures("without_pybullet")
def test_backends_says_how_to_get_a_missing_engine(run: Run) -> None:
    _, output, _ = run("backends")
    assert "pip install 'imolo[pybullet]'" in " ".join(output.split())


@pytest.mark.parametrize("name", [*BACKEND_PARAMS, "hardware"])
def test_what_the_source_says_of_a_backend_is_what_it_says_when_it_is_loaded(name: str) -> None:
    entry_point = entry_points(group=registry.BACKENDS.group)[name]
    assert summary_unloaded(entry_point) == registry.BACKENDS.load(name).summary


@pytest.mark.parametrize(
    "source",
    [
        "import nothing_of_this_name\nBACKEND = plugin(summary='made')",
        "if 1 > 0:\n    from nothing_of_this_name.part import x\nBACKEND = plugin(summary='made')",
        "from . import other\nBACKEND = plugin(summary='made')",
        "raise ImportError('get it elsewhere')\nBACKEND = plugin(summary='made')",
        "BACKEND = plugin('made')",
        "BACKEND = (",
    ],
)
def test_source_that_does_not_tell_is_left_to_the_import(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "made_plugin").mkdir()
    for name, text in {"__init__": "", "other": "import nothing_of_this_name", "engine": source}.items():
        (tmp_path / "made_plugin" / f"{name}.py").write_text(text, encoding="utf-8")
    for loaded in [name for name in sys.modules if name.startswith("made_plugin")]:
        monkeypatch.delitem(sys.modules, loaded)
    assert summary_unloaded(EntryPoint("made", "made_plugin.engine:BACKEND", "imolo.backends")) is None


def test_extra_without_a_wheel_for_this_python_is_not_advised() -> None:
    requires = ["numpy>=1", "dartpy>=6; extra == 'dart'", "pybullet>=3; python_version < '3' and extra == 'pybullet'"]
    assert registry.installs("dart", requires)
    assert not registry.installs("pybullet", requires)
    assert not registry.installs("none", requires)


@pytest.mark.parametrize("wrong", [None, ModuleType("ode")], ids=["none", "another package of this name"])
def test_missing_ode_ends_in_one_line_that_says_how_to_get_it(
    run: Run, monkeypatch: pytest.MonkeyPatch, wrong: ModuleType | None
) -> None:
    monkeypatch.setitem(sys.modules, "ode", wrong)
    for module in ("ode_engine", "ode_model", "ode_library"):
        monkeypatch.delitem(sys.modules, f"imolo_backends.engines.{module}", raising=False)
    Path("experiment.yaml").write_text("backend: {name: ode}\n", encoding="utf-8")
    code, _, errors = run("compare", "experiment.yaml")
    assert code == 2
    assert is_one_line_about(errors, "backend 'ode' cannot be used", "make ode")
    # PyPI has another package of this name.
    assert "pip install" not in errors

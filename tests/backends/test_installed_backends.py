"""`imolo backends` lists what is installed, and what is missing is told with the way to get it."""

import re
import shlex
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

import pytest
from command_line import Run, is_one_line_about
from requirements import BACKEND_PARAMS

from imolo.contracts import registry
from imolo.contracts.unloaded import summary_unloaded
from imolo.machine.extras import how_to_install

ADVICE = 'install it with: pip install "pybullet>=3.2.7"'


@pytest.mark.parametrize("name", BACKEND_PARAMS)
def test_backends_lists_every_engine_as_ready(run: Run, name: str) -> None:
    code, output, errors = run("backends")
    assert (code, errors) == (0, "")
    assert re.search(rf"^{name} +ready +\S", output, flags=re.MULTILINE)


@pytest.fixture
def without_pybullet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make Python find no PyBullet, as where the extra was not installed."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    for module in ("pybullet_engine", "pybullet_step"):
        monkeypatch.delitem(sys.modules, f"imolo_backends.engines.{module}", raising=False)


@pytest.mark.usefixtures("without_pybullet")
def test_missing_extra_ends_in_one_line_that_says_how_to_get_it(run: Run) -> None:
    Path("experiment.yaml").write_text("backend: {name: pybullet}\n", encoding="utf-8")
    code, _, errors = run("compare", "experiment.yaml")
    assert code == 2
    assert is_one_line_about(errors, "backend 'pybullet' cannot be used", ADVICE)


@pytest.mark.usefixtures("without_pybullet")
def test_missing_extra_leaves_the_other_backends_ready() -> None:
    status = {name: registry.BACKENDS.status(name) for name in ("dart", "mujoco", "pybullet")}
    assert status["pybullet"].plugin is None
    assert status["pybullet"].problem.endswith(ADVICE)
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
    assert ADVICE in " ".join(output.split())


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


def test_advice_names_the_package_itself_since_imolo_may_be_on_no_index() -> None:
    requirements = ["numpy>=1", "dartpy>=6.20; extra == 'dart'", "mcap>=1; extra == 'export'", "a<2; extra == 'export'"]
    assert how_to_install("dart", requirements) == 'install it with: pip install "dartpy>=6.20"'
    assert how_to_install("export", requirements) == 'install it with: pip install "mcap>=1" "a<2"'
    assert how_to_install("none", requirements) == ""
    assert how_to_install("farm", ["dask[distributed,array]<9,>=1; extra == 'farm'", "b; extra == 'farms'"]).endswith(
        ' "dask[array,distributed]<9,>=1"'
    )


@pytest.mark.parametrize(
    ("marker", "needs"),
    [
        ("python_version < '3' and extra == 'bullet'", "bullet needs Python < 3; this is Python"),
        ("(sys_platform == 'plan9') and extra == 'bullet'", "bullet needs sys_platform == plan9; this is Python"),
        ("extra == 'bullet' and python_version < '3'", "bullet needs Python < 3; this is Python"),
    ],
)
def test_package_that_is_not_for_this_python_or_system_is_not_advised(marker: str, needs: str) -> None:
    advice = how_to_install("bullet", [f"bullet>=3; {marker}"])
    assert advice.startswith(needs)
    assert "pip install" not in advice
    assert how_to_install("bullet", [f"bullet>=3; {marker}", "bullet-fork; extra == 'bullet'"]).endswith(
        '"bullet-fork"'
    )


@pytest.mark.parametrize("wrong", [None, ModuleType("ode")], ids=["none", "another package of this name"])
def test_missing_ode_ends_in_one_line_that_says_how_to_get_it(
    run: Run, monkeypatch: pytest.MonkeyPatch, wrong: ModuleType | None
) -> None:
    monkeypatch.setitem(sys.modules, "ode", wrong)
    for module in ("ode_engine", "ode_model", "ode_step", "ode_c", "ode_library"):
        monkeypatch.delitem(sys.modules, f"imolo_backends.engines.{module}", raising=False)
    Path("experiment.yaml").write_text("backend: {name: ode}\n", encoding="utf-8")
    code, _, errors = run("compare", "experiment.yaml")
    assert code == 2
    assert is_one_line_about(errors, "backend 'ode' cannot be used", "bash ")
    # PyPI has another package of this name, and a wheel brings no Makefile.
    assert "pip install" not in errors
    assert "make " not in errors
    script, python = shlex.split(errors.partition(": bash ")[2])
    assert Path(script).is_file()
    assert python == sys.executable

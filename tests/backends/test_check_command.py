"""`imolo check`: every scene has its verdict, whatever becomes of the engine, and every mistake ends in one line."""

import json
import re
import sys
from pathlib import Path

import pytest
from command_line import Run, interrupt, is_one_line_about

from imolo.conformance.runner import run_suites
from imolo.conformance.suite import Suite

BROKEN_PLUGIN = """
import os
import time

from imolo_backends.engines.mujoco_engine import MujocoEngine, MujocoOptions
from imolo_backends.simulation.simulated import simulated_plugin


class Engine(MujocoEngine):
    def step(self, joint_torque, ball_force):
        if not len(joint_torque):
            os.write(2, b"broken.cpp:7: out of luck\\n")
            os.abort()
        super().step(joint_torque, ball_force)


BACKEND = simulated_plugin(Engine, MujocoOptions, "an engine that crashes at its first step without joints")
"""


@pytest.fixture
def broken_plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install, as far as Python can tell, a distribution whose engine crashes."""
    folder = tmp_path / "plugins"
    about = folder / "broken-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "broken_plugin.py").write_text(BROKEN_PLUGIN, encoding="utf-8")
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text("[imolo.backends]\nbroken = broken_plugin:BACKEND\n", encoding="utf-8")
    monkeypatch.syspath_prepend(folder)


def test_check_reports_each_quantity_with_its_verdict(run: Run) -> None:
    code, output, errors = run("check", "mujoco", "--only", "free_fall", "--json", "numbers.json")
    assert (code, errors) == (0, "")
    assert re.search(r"^ +free_fall +height +18\.77\d* +18\.77\d* +1e-9 +m +pass", output, flags=re.MULTILINE)
    assert "mujoco: 1 scene, 3 quantities: 3 pass, 0 unsupported, 0 warning, 0 FAIL" in output
    (record,) = json.loads(Path("numbers.json").read_text(encoding="utf-8"))
    assert [outcome["verdict"] for outcome in record["outcomes"]] == ["pass"] * 3


def test_check_of_a_config_is_under_its_options(run: Run) -> None:
    Path("runge.yaml").write_text("backend: {name: mujoco, integrator: rk4}\n", encoding="utf-8")
    code, output, _ = run("check", "runge.yaml", "--only", "free_fall")
    assert code == 0
    # Without the bias of Euler's, which is half g dt t.
    assert re.search(r"^ +free_fall +height +18\.773[78] +18\.773[78] ", output, flags=re.MULTILINE)
    assert re.search(r"\brunge \(plug-in [^()]*, mujoco-core \S+, integrator: rk4\)", " ".join(output.split()))


def test_check_of_several_engines_ends_in_a_matrix(run: Run) -> None:
    code, output, _ = run("check", "mujoco", "pybullet", "--only", "clock")
    assert code == 0
    assert re.search(r"^ +scene +mujoco +pybullet", output, flags=re.MULTILINE)
    assert re.search(r"^ +clock +pass +pass", output, flags=re.MULTILINE)


@pytest.mark.usefixtures("broken_plugin")
def test_engine_that_crashes_fails_its_check_and_the_next_one_still_runs(run: Run) -> None:
    code, output, errors = run("check", "broken", "--only", "free_fall", "--only", "spinning_joint")
    assert (code, errors) == (1, "")
    assert "broken: 2 scenes, 2 quantities: 1 pass, 0 unsupported, 0 warning, 1 FAIL" in output
    died = "broken free_fall the process died with signal 6 (SIGABRT), after saying: broken.cpp:7: out of luck"
    assert died in " ".join(output.partition("Failed")[2].split())


@pytest.mark.usefixtures("broken_plugin")
def test_scene_that_takes_too_long_fails_and_the_next_one_still_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    # Of a process that was stopped nothing is heard any more.
    stopped = BROKEN_PLUGIN.replace("os.abort()", "time.sleep(600.0)")
    Path(sys.path[0], "broken_plugin.py").write_text(stopped, encoding="utf-8")
    monkeypatch.delitem(sys.modules, "broken_plugin", raising=False)
    outcomes = run_suites([Suite("broken", "broken")], ["free_fall", "spinning_joint"], time_limit=8.0)["broken"]
    assert [(o.check, o.verdict.value) for o in outcomes] == [("free_fall", "fail"), ("spinning_joint", "pass")]
    assert outcomes[0].remark == "took longer than 8 s"


@pytest.mark.usefixtures("broken_plugin")
def test_engine_that_dies_while_it_is_loaded_fails_every_check(run: Run, tmp_path: Path) -> None:
    # In the parent it loads.
    dies = "import multiprocessing\nimport os\nif multiprocessing.parent_process():\n    os._exit(3)\n"
    (tmp_path / "plugins" / "broken_plugin.py").write_text(dies + BROKEN_PLUGIN, encoding="utf-8")
    sys.modules.pop("broken_plugin", None)
    code, output, _ = run("check", "broken", "--only", "free_fall", "--only", "spinning_joint")
    assert code == 1
    assert output.count("cannot be loaded: the process ended with exit code 3") == 2


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("mujco",), ("unknown backend 'mujco'", "did you mean 'mujoco'?")),
        (("nothing.yaml",), ("nothing.yaml", "No such file")),
        (("mujoco", "mujoco"), ("'mujoco' would be reported twice",)),
        (("mujoco", "--only", "free_fal"), ("unknown check or group 'free_fal'", "did you mean 'free_fall'?")),
        (("mujoco", "--only", "free_fall", "--page", "page.md"), ("--page tells of all scenes",)),
        (("fine.yaml", "--page", "page.md"), ("--page tells of default options", "'mujoco'")),
        (("mujoco", "--only", "clock", "--json", "no/folder.json"), ("cannot write no/folder.json",)),
    ],
)
def test_mistake_in_what_is_to_be_checked_ends_in_one_line(
    run: Run, arguments: tuple[str, ...], parts: list[str]
) -> None:
    Path("fine.yaml").write_text("backend: {name: mujoco, integrator: rk4}\n", encoding="utf-8")
    code, _, errors = run("check", *arguments)
    assert code == 2
    assert is_one_line_about(errors, *parts)


def test_ctrl_c_ends_a_check_in_one_line(tmp_path: Path) -> None:
    def has_child(process: int) -> bool:
        return bool(Path(f"/proc/{process}/task/{process}/children").read_text().split())

    code, errors = interrupt(tmp_path, has_child, "check", "mujoco", "--jobs", 2)
    assert code == 130
    assert is_one_line_about(errors, "interrupted; 0 of", "scenes were done")

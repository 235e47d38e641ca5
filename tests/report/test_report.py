"""The report: one page that holds all of a results folder and needs nothing else."""

import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
import yaml
from results_folder import BALLS, METHODS, make_results, study_page

from imolo.campaigns.comparison import Comparison, summarise
from imolo.campaigns.results import ResultsFolder
from imolo.campaigns.summary import millimetres
from imolo.command_line.main import main
from imolo.config.experiment import PluginConfig
from imolo.config.loading import config_for
from imolo.errors import ImoloError, ResultsError
from imolo.report.page import write_report
from imolo.report.plausibility import check_numbers
from imolo.trials.metrics import wilson_interval


class Page(HTMLParser):
    """What a page refers to, its rows of trials, and its text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.references: list[tuple[str, str]] = []
        self.trials: list[str] = []
        self.tags: list[str] = []
        self.tables: list[list[list[str]]] = []
        self._cell: list[str] | None = None
        self.feed(self.source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        values = {name: value or "" for name, value in attrs}
        self.references += [
            (tag, values[name]) for name in ("src", "href", "srcset", "data", "action") if name in values
        ]
        if "data-trial" in values:
            self.trials.append(values["data-trial"])
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._cell = []

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th") and self._cell is not None:
            self.tables[-1][-1].append(" ".join("".join(self._cell).split()))
            self._cell = None

    def handle_data(self, data: str) -> None:
        if self._cell is not None:
            self._cell.append(data)


def replay(page: Page) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page.source, flags=re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> ResultsFolder:
    return make_results(tmp_path_factory.mktemp("results") / "with space")


@pytest.fixture(scope="module")
def page(folder: ResultsFolder) -> Page:
    return Page(write_report(folder.path, folder.path / "report.html").path)


def test_page_refers_to_nothing_but_itself_and_the_logs(page: Page, folder: ResultsFolder) -> None:
    logs = 0
    for tag, reference in page.references:
        if tag == "a" and reference.startswith("./"):
            assert (folder.path / unquote(reference)).is_file()
            logs += 1
        else:
            assert reference.startswith(("data:", "#"))
    assert logs == 2 * len(METHODS) * BALLS
    assert not re.search(r"https?://|//[a-z]+\.[a-z]|@import|url\(", page.source)
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|sendBeacon|importScripts|import)\s*\(", page.source)
    assert "default-src 'none'" in page.source


def test_page_holds_every_trial_once_and_can_replay_it(page: Page) -> None:
    expected = {
        f"{backend}/{method}/{ball}" for backend in ("alpha", "beta") for method in METHODS for ball in range(BALLS)
    }
    assert sorted(page.trials) == sorted(expected)
    assert sorted(trial["id"] for trial in replay(page)["trials"]) == sorted(expected)


def test_numbers_are_those_of_the_summary(page: Page, folder: ResultsFolder) -> None:
    summary = Comparison.model_validate_json((folder.path / "summary.json").read_text())
    rows = [row for row in page.tables[0] if row[1:2] and row[1] in METHODS]
    *ours, paper = rows
    results = [
        (name, method, result) for name, methods in summary.results.items() for method, result in methods.items()
    ]
    for row, (backend, method, result) in zip(ours, results, strict=True):
        low, high = wilson_interval(result.hits, result.balls)
        assert row[:3] == [backend, method, f"{result.hits}/{result.balls}"]
        assert row[4:6] == [f"{100 * low:.0f}–{100 * high:.0f} %", millimetres(result.hand_error)]
        assert row[6:9] == [millimetres(result.prediction_error[key]) for key in ("0.25", "0.50", "0.75")]
        assert row[9:] == ["0.20", "1.5"]
    assert paper[:3] == ["robot", "paper", "16/20"]
    trials = [trial for _, _, result in results for trial in result.trials]
    listed = [row for row in page.tables[2] if row[1:2] and row[1] in summary.results]
    for row, trial in zip(listed, trials, strict=True):
        hand = "–" if trial.hand_error is None else f"{1e3 * trial.hand_error:.0f}"
        assert row[3:7] == [f"ball {trial.trial}", trial.outcome, hand, f"{1e3 * trial.prediction_error['0.25']:.0f}"]


def test_provenance_names_seed_digests_versions_and_the_command(page: Page, folder: ResultsFolder) -> None:
    summary = Comparison.model_validate_json((folder.path / "summary.json").read_text())
    for text in (*summary.configs.values(), "imolo compare", "3.11", "observation_time: 0.1", "seed 7"):
        assert text in page.source


def test_names_and_outcomes_are_escaped(tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)>"
    folder = make_results(tmp_path / "results", backends=(evil,), outcome="</script><b>")
    page = Page(write_report(folder.path, tmp_path / "report.html").path)
    assert evil not in page.source
    assert "</script><b>" not in page.source
    assert page.tags.count("img") == 1  # the figure
    assert replay(page)["trials"][1]["outcome"] == "</script><b>"


def test_other_results_become_sections(tmp_path: Path) -> None:
    page = Page(study_page(tmp_path))
    assert ["alpha", "17/20 (64-95 %), 12±3 mm"] in [row for table in page.tables for row in table]
    assert "replay" not in {reference for _, reference in page.references}
    assert "<h1>From one engine to another</h1>" in page.source


def _remove(name: str) -> Callable[[Path], object]:
    return lambda path: (path / name).unlink()


def _write(name: str, text: str) -> Callable[[Path], object]:
    return lambda path: (path / name).write_text(text)


def _cut(name: str) -> Callable[[Path], object]:
    return lambda path: (path / name).write_text((path / name).read_text()[:200])


def _slow_down(decision: float) -> Callable[[Path], object]:
    """Return what sets the time of a decision [s]."""

    def edit(path: Path) -> None:
        content = json.loads((path / "timing.json").read_text())
        content["timing"]["alpha"]["paper"]["decision_median"] = decision
        (path / "timing.json").write_text(json.dumps(content))

    return edit


def _change(name: str, how: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[Path], object]:
    return lambda path: (path / name).write_text(yaml.safe_dump(how(yaml.safe_load((path / name).read_text()))))


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (_remove("summary.json"), ("summary.json", "imolo compare")),
        (_cut("summary.json"), ("summary.json", "imolo compare")),
        (_write("summary.json", '{"results": {}}'), ("summary.json", "seed", "imolo compare")),
        (_cut("timing.json"), ("timing.json", "imolo compare")),
        (_slow_down(-1.0), ("timing.json", "decision_median", "imolo compare")),
        (_remove("configs/beta.yaml"), ("beta.yaml", "missing", "imolo compare")),
        (_write("configs/beta.yaml", "a: [b"), ("beta.yaml", "imolo compare")),
        (_write("configs/beta.yaml", "seed: 1"), ("beta.yaml", "imolo compare")),
        (
            _change("configs/beta.yaml", lambda content: content | {"seeed": 1}),
            ("beta.yaml", "'seeed'", "imolo compare"),
        ),
        (
            _change("configs/beta.yaml", lambda content: {key: content[key] for key in content if key != "task"}),
            ("beta.yaml", "before robots were plug-ins", "imolo 0.1", "imolo compare"),
        ),
        (
            _change("configs/beta.yaml", lambda content: content | {"methods": {"other": content["methods"]["paper"]}}),
            ("beta.yaml", "'paper'"),
        ),
        (_write("ball.json", "{}"), ("ball.json", "is damaged")),
        (_write("attribution.json", "nonsense"), ("attribution.json", "is damaged")),
        (_write("interpolation.json", "{"), ("interpolation.json", "is damaged")),
        (_write("logs/beta/paper/hit_001.lcmlog", "no log at all"), ("hit_001.lcmlog",)),
    ],
)
def test_damage_is_told_in_one_line_with_file_and_fix(
    tmp_path: Path, damage: Callable[[Path], object], named: tuple[str, ...]
) -> None:
    folder = make_results(tmp_path / "results")
    damage(folder.path)
    with pytest.raises(ImoloError) as raised:
        write_report(folder.path, tmp_path / "report.html")
    assert "\n" not in str(raised.value)
    assert all(part in str(raised.value) for part in named)
    assert not (tmp_path / "report.html").exists()


def _edit(*place: str | int, value: object) -> Callable[[Path], object]:
    """Return what sets one number of the summary."""

    def edit(path: Path) -> None:
        content = json.loads((path / "summary.json").read_text())
        inner = content
        for part in place[:-1]:
            inner = inner[part]
        inner[place[-1]] = value
        (path / "summary.json").write_text(json.dumps(content))

    return edit


PAPER = ("results", "alpha", "paper")


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (_edit(*PAPER, "hits", value=999), "999 hits of 3 balls"),
        (_edit(*PAPER, "hits", value=-1), "-1 hits of 3 balls"),
        (_edit(*PAPER, "hits", value=1), "hits"),
        (_edit(*PAPER, "balls", value=20), "balls"),
        (_edit(*PAPER, "interval", value=[0.0, 2.0]), "interval"),
        (_edit(*PAPER, "started", value=50), "started is 50, but its trials say 2"),
        (_edit(*PAPER, "hand_error", "mean", value=float("nan")), "hand_error.mean is nan"),
        (_edit(*PAPER, "hand_error", "mean", value=-0.01), "hand_error.mean is -0.01"),
        (_edit(*PAPER, "hand_error", "sd", value=float("inf")), "hand_error.sd is inf"),
        (_edit(*PAPER, "prediction_error", "0.25", "count", value=7), "count is 7, but its trials say"),
        (_edit(*PAPER, "trials", 1, "hit", value=False), "hits"),
        (_edit(*PAPER, "trials", 1, "trial", value=2), "a trial twice"),
        (_edit(*PAPER, "causes", "no motion", value=3), "no motion"),
        (_edit("disagreement", "alpha - beta", "mean", value=-1), "mean is -1"),
        (_edit(*PAPER, "trials", 1, "trial", value=-5), "trials.1.trial"),
        (_edit(*PAPER, "trials", 1, "updates", value=-1), "trials.1.updates"),
        (_edit(*PAPER, "trials", 1, "updates", value=10**400), "updates has 401 digits"),
        (_edit("seed", value=-3), "seed"),
        (_edit("results", value={}), "missing in its results"),
        (_edit("results", "alpha", value={}), "missing in its results"),
    ],
)
def test_number_that_cannot_be_is_told_in_one_line(tmp_path: Path, edit: Callable[[Path], object], named: str) -> None:
    folder = make_results(tmp_path / "results")
    edit(folder.path)
    with pytest.raises(ResultsError) as raised:
        write_report(folder.path, tmp_path / "report.html")
    assert "\n" not in str(raised.value)
    assert all(part in str(raised.value) for part in ("summary.json is damaged", named, "imolo compare"))


def test_measure_of_a_task_may_be_negative() -> None:
    mean = {"mean": -0.1, "sd": 0.1, "count": 2}
    check_numbers(json.dumps({"alpha": {"measures": {"height [m]": mean}}}))
    with pytest.raises(ValueError, match="less than nothing"):
        check_numbers(json.dumps({"alpha": {"hand_error": mean}}))


@pytest.mark.parametrize("make", [False, True])
def test_folder_without_results_is_refused_with_the_command_that_makes_them(tmp_path: Path, make: bool) -> None:
    path = tmp_path / "nothing"
    if make:
        path.mkdir()
    with pytest.raises(ImoloError, match=r"nothing.*imolo compare --out"):
        write_report(path, tmp_path / "report.html")


def test_trial_without_its_log_is_listed_but_cannot_be_replayed(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "results")
    gone = folder.hits("alpha", "paper") / "hit_002.lcmlog"
    gone.unlink()
    written = write_report(folder.path, tmp_path / "report.html")
    page = Page(written.path)
    assert written.missing == (gone,)
    assert "alpha/paper/2" in page.trials
    assert "alpha/paper/2" not in {trial["id"] for trial in replay(page)["trials"]}


def test_results_of_one_method_are_read_as_imolo_hit_writes_them(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "results", backends=("alpha",))
    summary = Comparison.model_validate_json((folder.path / "summary.json").read_text())
    config = config_for("mujoco").model_copy(update={"backend": PluginConfig(name="mujoco")})
    results = {"alpha": {"paper": summary.results["alpha"]["paper"]}}
    written = summarise({"mujoco": config}, results, disagreement={})
    folder.save_json("summary.json", written)
    assert written.configs == {"mujoco": config.digest()}
    assert {"python", "imolo", "backend mujoco"} <= written.versions.keys()
    assert (written.seed, written.robot, written.task) == (config.seed, config.robot.name, config.task.name)
    (folder.path / "timing.json").unlink()
    for log in folder.hits("alpha", "improved").iterdir():
        log.unlink()
    page = Page(write_report(folder.path, tmp_path / "report.html").path)
    assert page.trials == [f"alpha/paper/{ball}" for ball in range(BALLS)]


def test_command_writes_into_the_results_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_results(tmp_path / "results")
    monkeypatch.setattr("sys.argv", ["imolo", "report", str(folder.path)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)
    assert f"the page is {folder.path / 'report.html'}" in capsys.readouterr().out
    assert (folder.path / "report.html").is_file()

"""Write everything that README and docs show of results, pictures and tables, from results folders (`make pages`).

Usage: python tools/pages.py [RESULTS]. For each page of `PAGES` whose folder is in RESULTS (by default results/), its
pictures are drawn anew, its tables are written between `<!-- pages:NAME -->` and `<!-- /pages -->` wherever they stand,
and docs/results/PAGE.json says what was shown and where it comes from. The other pages stay as they are, and are named.
"""

import hashlib
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import BaseModel

from imolo.campaigns.comparison import Comparison
from imolo.campaigns.figures import draw_all
from imolo.campaigns.results import Origin, ResultsFolder
from imolo.config.loading import load_config
from imolo.contracts.registry import ROBOTS
from imolo.errors import ImoloError
from imolo.inspect.diff import compare_logs
from imolo.inspect.divergence import draw_divergence
from imolo.inspect.fields import parse_selector
from imolo.inspect.plot import draw_fields, save_figure, short_names
from imolo.report.page import write_report
from imolo.report.sections import SECTIONS
from imolo.trials.causes import Cause
from imolo.trials.metrics import HORIZONS, Statistic
from imolo.view.sessions import recorded_sessions
from imolo.view.viewer import write_html

sys.path.insert(0, str(Path(__file__).parent))
from screens import moving_picture, picture_of_page, picture_of_spy, picture_of_view

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
IMAGES, SHOWN = DOCS / "images", DOCS / "results"
BLOCK = re.compile(r"(<!-- pages:(\S+) -->\n).*?(<!-- /pages -->)", re.DOTALL)
SPOKEN = {
    "mujoco": "MuJoCo",
    "pybullet": "PyBullet",
    "dart": "DART",
    "ode": "ODE",
    "drake": "Drake",
    "sapien": "SAPIEN",
}
METHOD = "improved"
BEFORE_THE_HIT = 0.055  # [s] of the view's picture


class Table(BaseModel):
    """A table of a page: titles of its columns, and rows of cells in Markdown."""

    columns: list[str]
    rows: list[list[str]]

    def markdown(self) -> str:
        """Return it as it stands on the page."""
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        return "".join(
            f"| {' | '.join(cells)} |\n".replace("| --- ", "|---").replace("|--- |", "|---|") for cells in lines
        )


class Shown(BaseModel):
    """What a page shows of a results folder, as docs/results/PAGE.json.

    Attributes:
        origin: Where the results come from.
        pictures: Names in docs/images, with the hash of each.
        tables: By the name of their block.
    """

    origin: Origin
    pictures: dict[str, str]
    tables: dict[str, Table] = {}


Draw = Callable[[Path, Path], None]
"""Draws from a results folder to a file."""


@dataclass(frozen=True)
class Page:
    """What is shown of one results folder.

    Attributes:
        marker: File that is there when the results are.
        pictures: By name in docs/images.
        tables: Makes the tables by the name of their block.
        draw: Draws the figures of the folder anew, as they are drawn now.
    """

    marker: str
    pictures: Mapping[str, Draw]
    tables: Callable[[Path], Mapping[str, Table]]
    draw: Callable[[Path], object] = lambda _: None


def copied(name: str) -> Draw:
    """Return what takes a figure of the folder."""
    return lambda folder, out: shutil.copyfile(folder / name, out) and None


def ball_logs(folder: Path) -> tuple[int, list[Path]]:
    """Return the first ball that every backend hit with the last method: its number, and the log of each backend."""
    results = _comparison(folder).results
    hit = [{one.trial for one in by_method[METHOD].trials if one.hit} for by_method in results.values()]
    number = min(set.intersection(*hit))
    return number, [folder / "logs" / backend / METHOD / f"hit_{number:03d}.lcmlog" for backend in results]


def draw_report(folder: Path, out: Path) -> None:
    """Draw the first screens of the report."""
    with TemporaryDirectory() as temporary:
        page = write_report(folder, Path(temporary) / "report.html").path
        picture_of_page(page, out, width=1280, height=1480)


def draw_hit(folder: Path, out: Path) -> None:
    """Draw the ball that the report's player begins with, as it moves."""
    with TemporaryDirectory() as temporary:
        moving_picture(write_report(folder, Path(temporary) / "report.html").path, out)


def draw_view(folder: Path, out: Path) -> None:
    """Draw the backends over each other, a moment before the first of them hits."""
    speed = 0.25
    _, logs = ball_logs(folder)
    sessions = recorded_sessions(logs, short_names(logs))
    moment = min(_hit_time(folder, logs)) - BEFORE_THE_HIT
    with TemporaryDirectory() as temporary:
        page = Path(temporary) / "view.html"
        write_html(sessions, page, speed)
        picture_of_view(page, out, width=1000, height=560, share=moment / max(one.duration for one in sessions))
    for session in sessions:
        session.close()


def _hit_time(folder: Path, logs: Iterable[Path]) -> list[float]:
    from imolo.messaging import channels
    from imolo.messaging.log import read_log

    events = [event for log in logs for event in read_log(log, (channels.TRIAL,)).messages[channels.TRIAL]]
    return [event.utime * 1e-6 for event in events if event.event == "touch"]


def draw_plot(folder: Path, out: Path) -> None:
    """Draw pressures and joint angles of the first backend and the last one."""
    logs = ball_logs(folder)[1]
    fields = ("ACTUATOR_STATE.measured[0:3]", "TRUTH_ROBOT.joint_angle[0:3]")
    save_figure(draw_fields([logs[0], logs[-1]], [parse_selector(field) for field in fields]), out)


def draw_diff(folder: Path, out: Path) -> None:
    """Draw how the first backend and the last one go apart."""
    first, *_, last = ball_logs(folder)[1]
    save_figure(draw_divergence(first, last, compare_logs(first, last, (None, None)).first), out)


def draw_spy(folder: Path, out: Path) -> None:
    """Draw lcm-spy while it plays a log."""
    picture_of_spy(ball_logs(folder)[1][0], out)


def draw_figures(folder: Path) -> None:
    """Draw the figures of a comparison from its logs and tables."""
    found = _comparison(folder)
    configs = [load_config(folder / "configs" / f"{backend}.yaml") for backend in found.results]
    draw_all(found, configs, ResultsFolder(folder))


def _comparison(folder: Path) -> Comparison:
    return Comparison.model_validate_json((folder / "summary.json").read_text(encoding="utf-8"))


def comparison_table(folder: Path) -> dict[str, Table]:
    """Return a row for each backend and method, and for what is published of the robot itself."""
    columns = ["backend", "method", "hits", "Wilson 95 %", "hand", *(f"ball {horizon:.2f} s" for horizon in HORIZONS)]
    found = _comparison(folder).results
    rows = []
    for backend, methods in found.items():
        for method, result in methods.items():
            low, high = result.interval
            hits = f"{result.hits}/{result.balls}"
            errors = [result.prediction_error[f"{horizon:.2f}"] for horizon in HORIZONS]
            rows.append(
                [
                    SPOKEN.get(backend, backend),
                    method,
                    f"**{hits}**" if method == METHOD else hits,
                    f"{100 * low:.0f}-{100 * high:.0f} %",
                    _spread(result.hand_error),
                    *(_spread(error, result.balls) for error in errors),
                ]
            )
    robot = load_config(folder / "configs" / f"{next(iter(found))}.yaml").robot.name
    for one in ROBOTS.load(robot).published:
        balls = [one.ball_errors.get(f"{horizon:.2f}", "-") for horizon in HORIZONS]
        cells = [robot.capitalize(), one.method, one.successes, one.interval, one.hand_error, *balls]
        rows.append([f"*{cell}*" for cell in cells])
    return {"comparison": Table(columns=columns, rows=rows)}


def balls_tables(folder: Path) -> dict[str, Table]:
    """Return how many balls were hit, as of a comparison, and why the others were missed."""
    found = _comparison(folder).results
    causes = [cause for cause in Cause if any(result.causes[cause] for by in found.values() for result in by.values())]
    rows = [
        [
            SPOKEN.get(backend, backend),
            method,
            *(str(result.causes[cause]) for cause in causes),
            *(f"{place.hits}/{place.balls}" for place in result.positions),
        ]
        for backend, methods in found.items()
        for method, result in methods.items()
    ]
    places = range(1, len(rows[0]) - 1 - len(causes))
    columns = ["backend", "method", *causes, *(f"from {place}" for place in places)]
    (hits,) = comparison_table(folder).values()
    return {"balls-hits": hits, "balls-causes": Table(columns=columns, rows=rows)}


def _spread(size: Statistic, balls: int = 0) -> str:
    """Return mean ± sd in millimetres; in brackets the number of balls where fewer than half had any."""
    if size.mean is None:
        return "-"
    text = f"{1e3 * size.mean:.0f}" + ("" if size.sd is None else f" ± {1e3 * size.sd:.0f}")
    return f"{text} ({size.count})" if 2 * size.count < balls else text


def study_page(name: str, file: str, picture: str = "", figure: str = "") -> Page:
    """Return what is shown of a study: the tables that the report has of it, and its figure."""
    (section,) = (one for one in SECTIONS if one.file == file)

    def tables(folder: Path) -> Mapping[str, Table]:
        grids: Sequence[object] = section.prepare(folder / file)["grids"]
        return {
            f"{name}-{number}": Table(
                columns=[" ".join(str(title).split()) for title in grid.columns],
                rows=[[str(cell) for cell in row] for row in grid.rows],
            )
            for number, grid in enumerate(grids, start=1)
        }

    return Page(file, {picture or f"{name}.png": copied(figure or f"figures/{name}.png")}, tables)


PAGES = {
    "demo": Page(
        "summary.json",
        {
            **{
                f"{name}.png": copied(f"figures/{name}.png")
                for name in ("trajectories", "reach", "hit_rates", "pressures")
            },
            "report.png": draw_report,
            "hit.gif": draw_hit,
            "view.png": draw_view,
            "plot.png": draw_plot,
            "divergence.png": draw_diff,
            "lcm-spy.png": draw_spy,
        },
        comparison_table,
        draw_figures,
    ),
    "balls": Page("summary.json", {}, balls_tables),
    "ball": study_page("ball", "ball.json", "ball_prediction.png", "ball.png"),
    "interpolation": study_page("interpolation", "interpolation.json"),
    "transfer": study_page("transfer", "transfer.json"),
    "trials": study_page("trials", "trials.json"),
    "waterfall": study_page("waterfall", "attribution.json"),
    "waterfall_ode": study_page("waterfall_ode", "attribution.json", figure="figures/waterfall.png"),
}


def digest(path: Path) -> str:
    """Return what tells a picture from another one."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def shown(name: str) -> Shown:
    """Return what a page shows."""
    return Shown.model_validate_json((SHOWN / f"{name}.json").read_text(encoding="utf-8"))


def write_page(name: str, folder: Path) -> None:
    """Draw the pictures of a page, and write what it shows and where that comes from."""
    page = PAGES[name]
    origin = Origin.model_validate_json((folder / "origin.json").read_text(encoding="utf-8"))
    page.draw(folder)
    for picture, draw in page.pictures.items():
        draw(folder, IMAGES / picture)
        print(f"  {picture}", flush=True)
    pictures = {picture: digest(IMAGES / picture) for picture in page.pictures}
    content = Shown(origin=origin, pictures=pictures, tables=dict(page.tables(folder)))
    text = json.dumps(content.model_dump(), indent=1, ensure_ascii=False)
    (SHOWN / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


def fill_blocks(text: str, tables: Mapping[str, Table]) -> str:
    """Return a page whose marked blocks hold the tables of their names."""
    return BLOCK.sub(lambda found: found[1] + tables[found[2]].markdown() + found[3], text)


def main() -> int:
    """Write the pages whose results are there."""
    results = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "results")
    for name, page in PAGES.items():
        if (results / name / page.marker).exists():
            print(f"{name}: from {results / name}")
            write_page(name, results / name)
        else:
            print(f"{name}: stays as it is; `{shown(name).origin.command}` writes results to draw it from")
    tables = {block: table for name in PAGES for block, table in shown(name).tables.items()}
    for path in (ROOT / "README.md", *DOCS.rglob("*.md")):
        before = path.read_text(encoding="utf-8")
        if (after := fill_blocks(before, tables)) != before:
            path.write_text(after, encoding="utf-8")
            print(f"{path.relative_to(ROOT)}: tables written")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ImoloError as error:
        sys.exit(f"pages: {error}")

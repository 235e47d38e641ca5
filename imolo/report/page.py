"""Write the page: templates, numbers, figures and motion in one file that asks nothing of a network."""

import base64
import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from imolo import __version__
from imolo.campaigns.appearance import engine_appearance, swatch
from imolo.campaigns.summary import millimetres
from imolo.config.loading import body_of, known_body, task_plugin
from imolo.contracts.registry import ROBOTS
from imolo.contracts.robot import Published
from imolo.errors import ResultsError
from imolo.machine.files import write_whole
from imolo.messaging import channels
from imolo.messaging.log import read_log
from imolo.report.folder import Campaign, ReportedTrial, read_campaign
from imolo.report.robot_shapes import robot_shapes
from imolo.report.sections import SECTIONS, Section
from imolo.report.tracks import trial_tracks
from imolo.trials.metrics import HORIZONS, wilson_interval

PICTURE_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
CAPTIONS = {
    "trajectories": "Ball and right hand until the hit, for the last method.",
    "pressures": "The last training motion: what the first engine's actuators measured, and how the others differ.",
    "reach": "Where the lookup table can bring the hand.",
    "hit_rates": "Hit rates with their Wilson 95 % intervals.",
    "waterfall": "What each swap explains of the disagreement.",
    "ball": "Error and calibration against the lead time.",
}
SMALLEST_TEXT = 9.0  # [px] in a figure on a narrow screen, which is scrolled in its frame
FAILURES = {"missed": "miss", "no motion found": "none"}  # classes of the stylesheet; a success is "hit"

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Written:
    """What became of a report.

    Attributes:
        path: The page.
        size: Of the page [bytes].
        trials: Number of trials in it.
        missing: Logs that are not there; their trials cannot be replayed.
    """

    path: Path
    size: int
    trials: int
    missing: tuple[Path, ...]


def write_report(folder: Path, out: Path, progress: Progress = lambda *_: None) -> Written:
    """Write the page of a results folder.

    Args:
        folder: What `imolo compare`, `hit`, `ball` or `attribute` wrote.
        out: File to write.
        progress: Told how many logs were read.

    Raises:
        ResultsError: The folder holds no results, a file in it is damaged, or the page cannot be written.
        BusError: A log is none.
    """
    if not folder.is_dir():
        raise ResultsError(f"{folder} is no folder; `imolo compare --out {folder}` writes one")
    campaign = read_campaign(folder)
    sections = [section for section in SECTIONS if (folder / section.file).exists()]
    if campaign is None and not sections:
        raise ResultsError(
            f"{folder} holds no summary.json and no other results; `imolo compare --out {folder}` writes them"
        )
    prepared = [_section(section, folder) for section in sections]
    missing = tuple(t.log_path for t in campaign.trials if not t.log_path.exists()) if campaign else ()
    shown = {name for section in sections for name in section.figures}
    context: dict[str, Any] = {
        "name": folder.resolve().name,
        "version": __version__,
        "sections": prepared,
        "title": _title(campaign, prepared),
        "figures": [_figure(path) for path in _pictures(folder / "figures") if f"figures/{path.name}" not in shown],
        "campaign": None,
        "data": None,
    }
    if campaign is not None:
        context.update(_campaign(campaign, folder, out))
        context["data"] = _as_script(_replay(campaign, out, progress))
    page = _environment().get_template("page.html").render(context)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, page)
    except OSError as error:
        raise ResultsError(f"cannot write {out}: {error.strerror}; choose another --out") from error
    return Written(out, len(page.encode()), len(campaign.trials) if campaign else 0, missing)


def _environment() -> Environment:
    loader = PackageLoader("imolo.report")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )

    def part(name: str) -> Markup:
        """Return a script or stylesheet of ours as it is."""
        return Markup(loader.get_source(environment, name)[0])

    environment.globals["part"] = part
    environment.filters["percent"] = lambda share: f"{100 * share:.0f}"
    environment.filters["mm"] = lambda length: "–" if length is None else f"{1e3 * length:.0f}"
    return environment


def _as_script(content: Any) -> Markup:
    """Return JSON that is safe inside a script element, whatever its strings hold."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def _title(campaign: Campaign | None, sections: Sequence[dict[str, Any]]) -> str:
    """Return what the folder holds in a few words: the task that was played, or the study."""
    if campaign is not None:
        return task_plugin(next(iter(campaign.configs.values()))).title
    titles = [str(section.get("study") or section["title"]) for section in sections]
    return titles[0] if len(titles) == 1 else "Results"


def _section(section: Section, folder: Path) -> dict[str, Any]:
    figures = [_figure(folder / name) for name in section.figures if (folder / name).exists()]
    prepared = section.prepare(folder / section.file)
    return {
        "title": section.title,
        "anchor": section.anchor,
        "file": section.file,
        "template": section.template,
        "figures": figures,
        "study": "",
        **prepared,
    }


def _pictures(folder: Path) -> list[Path]:
    known = list(CAPTIONS)
    found = [path for path in folder.glob("*") if path.suffix in PICTURE_TYPES and path == _drawn(path)]
    return sorted(found, key=lambda path: (known.index(path.stem) if path.stem in known else len(known), path.name))


def _drawn(path: Path) -> Path:
    """Return the drawing beside a picture, which follows dark pages and can be read at any size."""
    drawing = path.with_suffix(".svg")
    return drawing if drawing.exists() else path


def _figure(path: Path) -> dict[str, Any]:
    try:
        content = _drawn(path).read_bytes()
    except OSError as error:
        raise ResultsError(f"cannot read the figure {path}: {error.strerror}; remove it, or draw it again") from error
    caption = CAPTIONS.get(path.stem, path.stem.replace("_", " "))
    kind, data = PICTURE_TYPES[_drawn(path).suffix], base64.b64encode(content).decode("ascii")
    return {"caption": caption, "source": f"data:{kind};base64,{data}", **_sizes(content.decode(errors="replace"))}


def _sizes(drawing: str) -> dict[str, float | None]:
    """Return how wide a drawing of ours is [pt], and how wide its smallest text is large enough [px]."""
    width = re.search(r'viewBox="0 0 ([\d.]+) ', drawing)
    texts = [float(size) for size in re.findall(r"font(?:-size)?: ([\d.]+)px", drawing)]
    if width is None or not texts:
        return {"width": None, "least": None}
    return {"width": round(float(width[1]), 1), "least": round(float(width[1]) * SMALLEST_TEXT / min(texts), 1)}


def _campaign(campaign: Campaign, folder: Path, out: Path) -> dict[str, Any]:
    config = next(iter(campaign.configs.values()))
    task = task_plugin(config)
    methods = list(dict.fromkeys(method for by_method in campaign.results.values() for method in by_method))
    return {
        "campaign": campaign,
        "swatches": _swatches(campaign),
        "colors": _colors(campaign),
        "methods": methods,
        "horizons": [f"{horizon:.2f}" for horizon in HORIZONS],
        "millimetres": millimetres,
        "published": [_published(one) for one in ROBOTS.load(config.robot.name).published],
        "task": task,
        "robot": ROBOTS.load(config.robot.name).summary,
        "parameters": [parameter.name for parameter in config.motion.parameters],
        "compared_at": f"{config.training.comparison_time:g}",
        "trials": [_row(trial, out) for trial in campaign.trials],
        "outcomes": (task.success, *FAILURES),
        "commands": _commands(campaign, folder),
        "balls": max((r.balls for by_method in campaign.results.values() for r in by_method.values()), default=0),
    }


def _colors(campaign: Campaign) -> dict[str, str]:
    return {backend: engine_appearance(backend).color for backend in campaign.results}


def _swatches(campaign: Campaign) -> dict[str, str]:
    return {backend: swatch(engine_appearance(backend)) for backend in campaign.results}


def _published(one: Published) -> dict[str, Any]:
    """Return what is known of the robot itself as a row of the summary."""
    done, balls = (int(part) for part in one.successes.split("/"))
    return {
        "backend": "robot",
        "method": one.method,
        "hits": done,
        "balls": balls,
        "interval": wilson_interval(done, balls),
        "hand": one.hand_error,
        "ball": [one.ball_errors.get(f"{horizon:.2f}", "–") for horizon in HORIZONS],
        "source": one.source,
    }


def _row(trial: ReportedTrial, out: Path) -> dict[str, Any]:
    return {
        "id": _identity(trial),
        "backend": trial.backend,
        "method": trial.method,
        "result": trial.result,
        "outcome": "hit" if trial.result.hit else FAILURES.get(trial.result.outcome, "none"),
        "log": _link(trial.log_path, out) if trial.log_path.exists() else None,
    }


def _identity(trial: ReportedTrial) -> str:
    return f"{trial.backend}/{trial.method}/{trial.result.trial}"


def _relative(path: Path, out: Path) -> str:
    return Path(os.path.relpath(path.resolve(), out.resolve().parent)).as_posix()


def _link(path: Path, out: Path) -> str:
    # With ./ in front, since a colon in the first part would be read as a protocol.
    return f"./{quote(_relative(path, out))}"


def _commands(campaign: Campaign, folder: Path) -> list[tuple[str, str]]:
    """Return what to type to get the same again; the resolved configs hold seed and number of balls."""
    configs = " ".join(str(folder / "configs" / f"{backend}.yaml") for backend in campaign.configs)
    report = [("This page", f"imolo report {folder}")]
    if not campaign.digests:
        return report
    return [("The same results again, to the last digit", f"imolo compare {configs} --out AGAIN"), *report]


def _replay(campaign: Campaign, out: Path, progress: Progress) -> dict[str, Any]:
    """Return what the player needs: the robot, and the motion of every trial whose log is there."""
    trials = []
    robots: set[str] = set()
    # A page's player has one scene, and a comparison one robot.
    for number, trial in enumerate(campaign.trials):
        progress("logs", number, len(campaign.trials))
        if trial.log_path.exists():
            log = read_log(trial.log_path)
            config = campaign.configs[trial.backend]
            trials.append(
                {
                    "id": _identity(trial),
                    "backend": trial.backend,
                    "method": trial.method,
                    "number": trial.result.trial,
                    "outcome": trial.result.outcome,
                    "success": trial.result.hit,
                    "path": _relative(trial.log_path, out),
                    "voxel": config.methods[trial.method].grid.spacing,
                    **trial_tracks(log, body_of(config.robot)),
                }
            )
            robots.update(event.robot for event in log.messages[channels.TRIAL] if event.robot)
    progress("logs", len(campaign.trials), len(campaign.trials))
    radius = next(iter(campaign.configs.values())).simulation.ball.radius
    body = known_body(sorted(robots)[0]) if robots else None
    return {
        "robot": None if body is None else robot_shapes(body),
        "radius": radius,
        "colors": _colors(campaign),
        "swatches": _swatches(campaign),
        "trials": trials,
    }

"""How figures, report and view look.

An engine has the same colour, marker and line everywhere, and nothing that is no engine has its colour.
"""

import math
import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple
from zlib import crc32

import matplotlib as mpl
from matplotlib.figure import Figure


class Appearance(NamedTuple):
    """How a series is drawn: each of the three tells it from others, in grey too."""

    color: str
    marker: str
    line: Any  # of matplotlib

    def style(self, **more: Any) -> dict[str, Any]:
        """Return the arguments of a plot with markers."""
        return {"color": self.color, "marker": self.marker, "linestyle": self.line, **more}


# Okabe and Ito's colours, which differ for colour-blind eyes too; their yellow is not seen on white, and black is ours.
ENGINES = {
    "mujoco": Appearance("#0072B2", "o", "-"),
    "pybullet": Appearance("#D55E00", "s", "--"),
    "dart": Appearance("#009E73", "^", "-."),
    "ode": Appearance("#CC79A7", "D", ":"),
    "drake": Appearance("#E69F00", "v", (0, (5, 1, 1, 1, 1, 1))),
    "sapien": Appearance("#56B4E9", "P", (0, (1, 1))),
}
# Tol's muted colours that are far from those above, for the engines of plug-ins.
GUEST_COLORS = ("#332288", "#882255", "#999933", "#AA4499", "#661100", "#117733")
GUEST_MARKERS = ("X", "<", ">", "p")
GUEST_LINES = ((0, (8, 2)), (0, (3, 1, 1, 1)), (0, (6, 2, 1, 2)), (0, (2, 3)))

SHOWN_UNITS = {"rad": ("°", math.degrees(1.0)), "m": ("mm", 1e3), "Pa": ("kPa", 1e-3)}

SHAPES = {
    "o": "circle(50%)",
    "s": "inset(6%)",
    "^": "polygon(50% 0, 100% 95%, 0 95%)",
    "v": "polygon(0 5%, 100% 5%, 50% 100%)",
    "<": "polygon(0 50%, 95% 0, 95% 100%)",
    ">": "polygon(5% 0, 100% 50%, 5% 100%)",
    "D": "polygon(50% 0, 100% 50%, 50% 100%, 0 50%)",
    "p": "polygon(50% 0, 100% 38%, 81% 100%, 19% 100%, 0 38%)",
    "*": "polygon(50% 0, 63% 36%, 100% 38%, 71% 61%, 81% 98%, 50% 77%, 19% 98%, 29% 61%, 0 38%, 37% 36%)",
    "h": "polygon(50% 0, 93% 25%, 93% 75%, 50% 100%, 7% 75%, 7% 25%)",
    "d": "polygon(50% 0, 80% 50%, 50% 100%, 20% 50%)",
    "8": "polygon(30% 0, 70% 0, 100% 30%, 100% 70%, 70% 100%, 30% 100%, 0 70%, 0 30%)",
    "1": "polygon(44% 50%, 0 75%, 5% 85%, 50% 60%, 95% 85%, 100% 75%, 56% 50%, 56% 0, 44% 0)",
    "2": "polygon(44% 50%, 0 25%, 5% 15%, 50% 40%, 95% 15%, 100% 25%, 56% 50%, 56% 100%, 44% 100%)",
    "P": "polygon(33% 0, 67% 0, 67% 33%, 100% 33%, 100% 67%, 67% 67%, 67% 100%, 33% 100%, 33% 67%, 0 67%, 0 33%,"
    " 33% 33%)",
    "X": "polygon(25% 0, 50% 25%, 75% 0, 100% 25%, 75% 50%, 100% 75%, 75% 100%, 50% 75%, 25% 100%, 0 75%, 25% 50%,"
    " 0 25%)",
}
"""Markers as shapes of CSS."""

INK, SOFT, FAINT, GRID, PAPER = "#1A1C20", "#596069", "#9AA0A6", "#E2E3E5", "#FFFFFF"
# Of series that are no engines: greys, with markers and lines of their own.
SERIES = (
    Appearance(INK, "*", "-"),
    Appearance(SOFT, "h", "--"),
    Appearance(FAINT, "d", "-."),
    Appearance(INK, "8", ":"),
    Appearance(SOFT, "1", (0, (5, 1, 1, 1, 1, 1))),
    Appearance(FAINT, "2", (0, (1, 1))),
)
Fill = Literal["none", "left", "full", "bottom"]
FILLS: tuple[Fill, ...] = ("none", "left", "full", "bottom")
"""How far the marker of an engine is filled: by method, or by fit."""
DARK = {INK: "#E9EAEC", SOFT: "#A0A7B1", FAINT: "#7F8894", GRID: "#2E3238", PAPER: "#1A1D21"}
"""What a dark page has in place of ink, greys and paper; as in the report's stylesheet."""
STYLE: Any = {
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 9.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.facecolor": "none",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.dpi": 150,
    "svg.fonttype": "none",
    "svg.hashsalt": "imolo",
    "font.family": ["DejaVu Sans"],
}
FONTS = "'DejaVu Sans', Verdana, 'Segoe UI', Roboto, sans-serif"


def engine_appearance(name: str) -> Appearance:
    """Return how an engine is drawn: one of ours as `ENGINES` says, another one by its name alone."""
    if name in ENGINES:
        return ENGINES[name]
    number, color = divmod(crc32(name.encode()), len(GUEST_COLORS))
    number, marker = divmod(number, len(GUEST_MARKERS))
    return Appearance(GUEST_COLORS[color], GUEST_MARKERS[marker], GUEST_LINES[number % len(GUEST_LINES)])


def appearances(engines: Sequence[str]) -> list[Appearance]:
    """Return how several runs are drawn: as their engines, or in greys where two of them are of one engine."""
    if len(set(engines)) == len(engines):
        return [engine_appearance(name) for name in engines]
    return [SERIES[number % len(SERIES)] for number in range(len(engines))]


def swatch(look: Appearance) -> str:
    """Return colour and marker of an engine as the style of an HTML element."""
    return f"background:{look.color};clip-path:{SHAPES[look.marker]}"


def shown_unit(unit: str) -> tuple[str, float]:
    """Return the unit that a figure shows in place of this one, and the factor to it."""
    return SHOWN_UNITS.get(unit, (unit, 1.0))


def element_colors(count: int) -> list[str]:
    """Return colours of the elements of an array, from dark to light, so that they differ in grey as well."""
    shades = mpl.colormaps["cividis"]
    return [mpl.colors.to_hex(shades(0.9 * number / max(count - 1, 1))) for number in range(count)]


def write_figure(figure: Figure, file: BinaryIO | Path, kind: str) -> None:
    """Write a figure; an SVG follows a dark page, and is the same for the same figure."""
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name in an alphabet that the font does not have is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        if kind != "svg":
            figure.savefig(file, format=kind, bbox_inches="tight", facecolor=PAPER)
            return
        drawn = BytesIO()
        figure.savefig(drawn, format=kind, bbox_inches="tight", facecolor=PAPER, metadata={"Date": None})
    text = _following_the_page(drawn.getvalue().decode())
    if isinstance(file, Path):
        file.write_text(text, encoding="utf-8")
    else:
        file.write(text.encode())


def _following_the_page(svg: str) -> str:
    rules = "".join(
        f"[style*='{part}: {light.lower()}']{{{part}:{dark} !important}}"
        for light, dark in DARK.items()
        for part in ("fill", "stroke")
    )
    style = (
        f"<style>text{{font-family:{FONTS} !important}}@media (prefers-color-scheme: dark){{"
        f"{rules}text:not([style*='fill']){{fill:{DARK[INK]}}}}}</style>"
    )
    head, end, rest = svg.partition("<defs>")
    return f"{head}{style}{end}{rest}"

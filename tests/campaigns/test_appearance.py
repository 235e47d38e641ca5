"""One colour, marker and line for an engine everywhere; figures that follow a dark page."""

from io import BytesIO
from itertools import combinations, pairwise

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from requirements import BACKEND_NAMES

from imolo.campaigns.appearance import (
    DARK,
    ENGINES,
    GUEST_COLORS,
    INK,
    PAPER,
    SERIES,
    STYLE,
    appearances,
    element_colors,
    engine_appearance,
    write_figure,
)

# Machado, Oliveira and Fernandes 2009, severity 1: what protan, deutan and tritan eyes see of linear RGB.
BLINDNESS = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    "full": np.eye(3).tolist(),
}
LEAST = 12.0  # CIE76 difference; 2.3 is just noticed side by side


def linear(color: str) -> np.ndarray:
    values = np.array(mpl.colors.to_rgb(color))
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of linear sRGB under D65."""
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x = matrix @ np.clip(rgb, 0.0, 1.0) / np.array([0.9505, 1.0, 1.089])
    f = np.where(x > 0.008856, np.cbrt(x), 7.787 * x + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def test_every_engine_of_ours_has_its_own_colour_marker_and_line() -> None:
    assert tuple(ENGINES) == BACKEND_NAMES
    for part in zip(*ENGINES.values(), strict=True):
        assert len(set(part)) == len(ENGINES)


@pytest.mark.parametrize("eyes", BLINDNESS)
def test_engines_differ_for_colour_blind_eyes(eyes: str) -> None:
    seen = {name: lab(np.array(BLINDNESS[eyes]) @ linear(look.color)) for name, look in ENGINES.items()}
    for one, other in combinations(seen, 2):
        assert np.linalg.norm(seen[one] - seen[other]) > LEAST, (one, other)


def test_engine_of_a_plug_in_looks_the_same_beside_any_others_and_like_none_of_ours() -> None:
    alone = appearances(["liftoff"])
    assert alone == appearances(["mujoco", "liftoff", "dart"])[1:2] == [engine_appearance("liftoff")]
    ours = ENGINES.values()
    for name in ("liftoff", "newton", "chrono", "isaac", "physx"):
        look = engine_appearance(name)
        assert all(set(look).isdisjoint(own) for own in ours)


def test_runs_of_one_engine_are_told_apart_without_the_colour_of_any() -> None:
    looks = appearances(["dart", "dart", "mujoco"])
    assert len(set(looks)) == 3
    engine_colors = {look.color for look in ENGINES.values()} | set(GUEST_COLORS)
    assert engine_colors.isdisjoint(look.color for look in (*looks, *SERIES))
    assert engine_colors.isdisjoint(element_colors(8))


@pytest.mark.parametrize("count", [1, 2, 8])
def test_elements_grow_lighter_so_that_they_differ_in_grey(count: int) -> None:
    lightness = [lab(linear(color))[0] for color in element_colors(count)]
    assert all(after - before > 5.0 for before, after in pairwise(lightness))


def svg() -> str:
    with mpl.rc_context(STYLE):
        figure = Figure()
        figure.subplots().plot([0.0, 1.0], color=INK, marker="o", mfc=PAPER, label="one")
    file = BytesIO()
    write_figure(figure, file, "svg")
    return file.getvalue().decode()


def test_figure_follows_a_dark_page_in_every_neutral_colour() -> None:
    text = svg()
    rules = text[text.index("prefers-color-scheme: dark") :].split("</style>")[0]
    for light, dark in DARK.items():
        if f"fill: {light.lower()}" in text.replace(rules, ""):
            assert f"[style*='fill: {light.lower()}']{{fill:{dark} !important}}" in rules
    assert "<text" in text  # words are words, which can be read at any size


def test_the_same_figure_is_the_same_file() -> None:
    assert svg() == svg()

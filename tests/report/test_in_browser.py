"""The page in a browser, where there is one: its scripts run, and nothing is asked of a network."""

import re
import subprocess
from html import unescape
from importlib.resources import files
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure
from requirements import needs
from results_folder import BALLS, METHODS, make_results, study_page

from imolo.campaigns.appearance import STYLE
from imolo.report.page import write_report

pytestmark = needs("chromium")

# What a user would do, written down in the page's title, which is read from the DOM.
ACTIONS = """
<script>
const heard = [];
addEventListener("error", (event) => heard.push(event.message));
addEventListener("load", () => {
  const say = (what) => heard.push(String(what));
  const count = () => document.getElementById("count").textContent;
  const filters = document.getElementById("filters");
  const filter = (name, value) => {
    filters.elements[name].value = value;
    filters.dispatchEvent(new Event("input"));
    say(count());
  };
  filter("backend", "alpha");
  filter("text", "ball 2 improved");
  const header = [...document.querySelectorAll("#list th button")].find((button) => button.textContent === "Hand");
  header.click(); header.click();
  say(document.querySelector("#list tbody tr").dataset.trial.split("/")[2]);
  document.querySelector(".map [data-show='beta/paper/1']").click();
  say(document.getElementById("hud").textContent);
  const slider = document.getElementById("time");
  slider.value = 0.5; slider.dispatchEvent(new Event("input"));
  say(document.getElementById("clock").textContent);
  // The trunk rises at 1 m/s.
  say(player.motion(player.chosen).links(0.5)[0][14].toFixed(2));
  document.getElementById("play").click();
  say(document.getElementById("play").getAttribute("aria-label"));
  say(performance.getEntriesByType("resource").filter((entry) => !entry.name.startsWith("data:")).length);
  document.title = heard.join("|");
});
</script>
"""


def title_of(page: Path, script: str, profile: Path, *more_flags: str) -> str:
    """Return what the title of a page is in a browser after a script has run."""
    copy = profile.with_suffix(".html")
    copy.write_text(page.read_text().replace("</head>", f"{script}</head>"))
    flags = ("--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking")
    more = ("--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader", "--use-angle=swiftshader")
    ended = subprocess.run(
        [
            "chromium",
            *flags,
            *more,
            *more_flags,
            f"--user-data-dir={profile}",
            "--virtual-time-budget=2000",
            "--dump-dom",
            copy.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    found = re.search(r"<title>(.*?)</title>", ended.stdout, flags=re.DOTALL)
    assert found is not None
    return unescape(found.group(1))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_results(tmp_path_factory.mktemp("results"))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.0))
        figure.subplots().set_xlabel("time [s]", fontsize=7)
    folder.save_drawing("hit_rates", figure)
    return write_report(folder.path, folder.path / "report.html").path


def test_filter_sort_and_player_work(page: Path, tmp_path: Path) -> None:
    total = 2 * len(METHODS) * BALLS
    assert title_of(page, ACTIONS, tmp_path / "profile").split("|") == [
        f"{total // 2} of {total}",
        f"1 of {total}",
        str(BALLS - 1),
        "Ball 1 · paper",
        "0.500 s",
        "0.50",
        "Pause",
        "0",
    ]


# A window is never as narrow as a phone, a frame is.
ON_A_PHONE = """
<script>
function look() {
  const small = [], size = (element) => parseFloat(getComputedStyle(element).fontSize);
  for (const element of document.querySelectorAll("body *")) {
    const says = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (says && element.getClientRects().length && size(element) < 9) small.push(element.tagName);
  }
  const drawings = [...document.querySelectorAll("figure img")].map((one) => one.clientWidth).join(" ");
  return [document.documentElement.scrollWidth, small.join(" "), drawings].join("|");
}
if (top === window) addEventListener("load", async () => {
  const frame = document.createElement("iframe");
  const loaded = new Promise((done) => frame.addEventListener("load", done));
  frame.width = 390; frame.height = 844; frame.style.border = 0;
  frame.srcdoc = document.documentElement.outerHTML;
  document.body.append(frame);
  await loaded;
  document.title = frame.contentWindow.look();
});
</script>
"""


def test_page_on_a_phone_neither_scrolls_sideways_nor_has_text_below_9_px(page: Path, tmp_path: Path) -> None:
    width, small, drawings = title_of(page, ON_A_PHONE, tmp_path / "profile").split("|")
    assert int(width) <= 390
    assert small == ""
    # The drawing is 11 in wide, and its smallest letters are 7 pt: 9 px high they make it 9 / 7 of its points wide.
    (drawn,) = [int(one) for one in drawings.split() if int(one) > 390]
    sizes = re.search(r"--natural: ([\d.]+); --least: ([\d.]+)", page.read_text())
    assert sizes is not None
    assert drawn >= float(sizes[1]) * 9.0 / 7.0 - 1.0


SHOW_AND_COPY = """
<script>
addEventListener("load", async () => {
  const heard = [];
  const dialog = document.querySelector("dialog.large");
  document.querySelector("figure img").click();
  heard.push(dialog.open, dialog.querySelector("img").src === document.querySelector("figure img").src);
  dialog.click();
  heard.push(dialog.open);
  let copied = "";
  Object.defineProperty(navigator, "clipboard", { value: { writeText: async (text) => { copied = text; } } });
  document.querySelector("#provenance .copy").click();
  await 0;
  heard.push(copied);
  document.title = heard.join("|");
});
</script>
"""


def test_figure_grows_on_a_click_and_command_is_copied_by_one(page: Path, tmp_path: Path) -> None:
    *shown, copied = title_of(page, SHOW_AND_COPY, tmp_path / "profile").split("|")
    assert shown == ["true", "true", "false"]
    assert copied.startswith("imolo compare ")


AXE = """
<script>
AXE_SOURCE
addEventListener("load", async () => {
  const found = (await axe.run(document)).violations.filter((one) => ["serious", "critical"].includes(one.impact));
  document.title = JSON.stringify(found.map((one) => [one.id, one.nodes[0].html]));
});
</script>
"""


@pytest.mark.parametrize("page_of", ["campaign", "study"])
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("mark", [pytest.param(None, marks=needs("axe"))], ids=["axe"])
def test_axe_finds_nothing_serious(page: Path, page_of: str, dark: bool, mark: None, tmp_path: Path) -> None:
    if page_of == "study":
        page = study_page(tmp_path)
    source = files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8").replace("</", "<\\/")
    flags = ("--force-dark-mode", "--blink-settings=preferredColorScheme=0") if dark else ()
    assert title_of(page, AXE.replace("AXE_SOURCE", source), tmp_path / "profile", *flags) == "[]"

"""The page in a browser, where there is one: its scripts run, and nothing is asked of a network."""

import re
import subprocess
from pathlib import Path

from requirements import needs
from results_folder import BALLS, METHODS, make_results

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


def test_filter_sort_and_player_work(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "results")
    path = write_report(folder.path, tmp_path / "report.html").path
    path.write_text(path.read_text().replace("</head>", f"{ACTIONS}</head>"))
    flags = ("--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking")
    more = ("--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader", "--use-angle=swiftshader")
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    ended = subprocess.run(
        ["chromium", *flags, *more, profile, "--virtual-time-budget=2000", "--dump-dom", path.as_uri()],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    found = re.search(r"<title>(.*?)</title>", ended.stdout)
    assert found is not None
    total = 2 * len(METHODS) * BALLS
    assert found.group(1).split("|") == [
        f"{total // 2} of {total}",
        f"1 of {total}",
        str(BALLS - 1),
        "Ball 1 · paper",
        "0.500 s",
        "0.50",
        "Pause",
        "0",
    ]

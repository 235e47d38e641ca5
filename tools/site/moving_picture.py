"""A hit as a moving picture, drawn by the report's player frame by frame.

`python -m tools.site.moving_picture RESULTS OUT.gif`
"""

import base64
import json
import re
import subprocess
import sys
import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image

from imolo.errors import MissingToolError
from imolo.report.page import write_report

SIZE = (540, 360)  # [px]
COLORS = 96
STEP = 0.015  # [s] of the trial from frame to frame
SHOWN = 60  # [ms] each; a quarter of real time
LAST_SHOWN = 1500  # [ms]
FLAGS = ("--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--window-size=1200,900")
SOFTWARE = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader")  # WebGL where there is no graphics card

# Painted and read in one go, since WebGL's picture is gone once the page is shown.
SCRIPT = """
<style>#canvas { width: %dpx !important; height: %dpx !important; } :root { color-scheme: light; }</style>
<script>
addEventListener("load", () => {
  const frames = [], events = player.motion(player.chosen).event;
  for (let time = events.throw; time < Math.min(player.duration, events.touch + 0.15); time += %f) {
    player.seek(time);
    player.paint();
    frames.push(player.canvas.toDataURL("image/png").split(",")[1]);
  }
  const told = Object.assign(document.createElement("pre"), { id: "frames", textContent: JSON.stringify(frames) });
  document.body.replaceChildren(told);
});
</script>
</head>
"""


def draw(results: Path, out: Path) -> None:
    """Write the ball that most engines hit as a GIF.

    Args:
        results: Folder that `imolo compare` wrote.
        out: Picture to write.

    Raises:
        MissingToolError: There is no Chromium, or it could not draw.
    """
    with tempfile.TemporaryDirectory() as folder:
        page = write_report(results, Path(folder) / "report.html").path
        page.write_text(page.read_text("utf-8").replace("</head>", SCRIPT % (*SIZE, STEP), 1), "utf-8")
        command = ["chromium", *FLAGS, *SOFTWARE, f"--user-data-dir={folder}/profile", "--dump-dom", page.as_uri()]
        try:
            dumped = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
        except FileNotFoundError as error:
            raise MissingToolError("chromium not found; apt-get install chromium") from error
    found = re.search(r'<pre id="frames">(.*?)</pre>', dumped, re.DOTALL)
    if found is None:
        raise MissingToolError("chromium drew nothing; has it WebGL 2?")
    frames = [
        Image.open(BytesIO(base64.b64decode(frame))).convert("RGB").resize(SIZE) for frame in json.loads(found[1])
    ]
    # One palette for all: what does not move is then the same in each frame and costs nothing.
    palette = frames[-1].quantize(COLORS)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    shown = [SHOWN] * len(others) + [LAST_SHOWN]
    first.save(out, save_all=True, append_images=others, duration=shown, loop=0, optimize=True)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))

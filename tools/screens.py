"""Pictures of what is seen on a screen: a page in Chromium, the browser view, lcm-spy."""

import asyncio
import base64
import json
import os
import subprocess
import time
import urllib.request
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import websockets
from numpy.typing import NDArray
from PIL import Image

from imolo.inspect.spy import spy_command
from imolo.messaging.udpm import LOCAL_URL

CHROMIUM = (
    "chromium",
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--enable-unsafe-swiftshader",
    "--use-angle=swiftshader",
    "--remote-debugging-port=0",
)
PATIENCE = 120.0  # [s]
SPY_SCREEN = "1240x700x24"

GIF_SIZE = (540, 360)  # [px]
GIF_COLORS = 96
GIF_STEP = 0.015  # [s] of the trial from frame to frame
GIF_SHOWN = 60  # [ms] each; a quarter of real time
GIF_LAST_SHOWN = 1500  # [ms]
# Painted and read in one go, since WebGL's picture is gone once the page is shown.
GIF_FRAMES = """(() => {
  const style = "<style>#canvas { width: %dpx !important; height: %dpx !important; }</style>";
  document.head.insertAdjacentHTML("beforeend", style);
  const frames = [], events = player.motion(player.chosen).event;
  for (let time = events.throw; time < Math.min(player.duration, events.touch + 0.15); time += %f) {
    player.seek(time);
    player.paint();
    frames.push(player.canvas.toDataURL("image/png").split(",")[1]);
  }
  return frames;
})()"""

Call = Callable[..., Awaitable[Any]]


class Browser:
    """A headless Chromium with one page, driven by its DevTools protocol.

    Attributes:
        call: Sends a command with its parameters, and returns the answer.
    """

    def __init__(self, call: Call) -> None:
        """Take the connection to a page."""
        self.call = call

    async def run(self, script: str) -> Any:
        """Return what a script says, once its promise is kept."""
        answer = await self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        return answer.get("result", {}).get("value")

    async def until(self, script: str) -> None:
        """Wait until a script says something true.

        Raises:
            TimeoutError: It never did.
        """
        end = time.monotonic() + PATIENCE
        while not await self.run(script):
            if time.monotonic() > end:
                raise TimeoutError(f"{script} was not true in {PATIENCE:g} s")
            await asyncio.sleep(0.2)

    async def open(self, page: Path) -> None:
        """Go to a page, and wait until it is there."""
        address = page.resolve().as_uri()
        await self.call("Page.navigate", url=address)
        await self.until(f"document.readyState === 'complete' && location.href === {json.dumps(address)}")

    async def color_scheme(self, name: str) -> None:
        """Be a browser whose user likes pages `light` or `dark`."""
        await self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    async def click(self, x: float, y: float) -> None:
        """Press and release the mouse there [px]."""
        for kind in ("mousePressed", "mouseReleased"):
            await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    async def picture(self, out: Path) -> None:
        """Write what the window shows."""
        answer = await self.call("Page.captureScreenshot", format="png")
        out.write_bytes(base64.b64decode(answer["data"]))


def browse(page: Path, width: int, height: int, act: Callable[[Browser], Awaitable[Any]]) -> Any:
    """Open a page in a window of this size, and return what `act` makes of it."""

    async def session(address: str) -> Any:
        async with websockets.connect(address, max_size=None) as socket:
            count = 0

            async def call(method: str, **parameters: Any) -> Any:
                nonlocal count
                count += 1
                await socket.send(json.dumps({"id": count, "method": method, "params": parameters}))
                while (answer := json.loads(await socket.recv())).get("id") != count:
                    pass
                return answer.get("result", {})

            browser = Browser(call)
            await browser.color_scheme("light")
            await call(
                "Emulation.setDeviceMetricsOverride",
                width=width,
                height=height,
                deviceScaleFactor=1,
                mobile=width < 500,
            )
            await call("Emulation.setScrollbarsHidden", hidden=True)
            await browser.open(page)
            return await act(browser)

    with _chromium() as address:
        return asyncio.run(session(address))


@contextmanager
def _chromium() -> Iterator[str]:
    """Start a browser and yield the address of its page."""
    with (
        TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        subprocess.Popen(
            [*CHROMIUM, f"--user-data-dir={profile}", "about:blank"], stderr=subprocess.PIPE, text=True
        ) as program,
    ):
        try:
            lines = iter(program.stderr.readline, "") if program.stderr else iter(())
            told = next(line for line in lines if "DevTools listening on" in line)
            port = told.split(":")[-1].split("/")[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=PATIENCE) as answer:
                pages = json.load(answer)
            yield next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
        finally:
            program.terminate()


def picture_of_page(page: Path, out: Path, width: int, height: int) -> None:
    """Write the first screen of a page."""

    async def act(browser: Browser) -> None:
        await browser.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        await browser.picture(out)

    browse(page, width, height, act)


def moving_picture(page: Path, out: Path) -> None:
    """Write the ball that a report's player begins with as a GIF, which plays once (WCAG 2.2.2)."""

    async def act(browser: Browser) -> Any:
        return await browser.run(GIF_FRAMES % (*GIF_SIZE, GIF_STEP))

    frames = [
        Image.open(BytesIO(base64.b64decode(frame))).convert("RGB").resize(GIF_SIZE)
        for frame in browse(page, 1200, 900, act)
    ]
    # One palette for all: what does not move is then the same in each frame and costs nothing.
    palette = frames[-1].quantize(GIF_COLORS)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    shown = [GIF_SHOWN] * len(others) + [GIF_LAST_SHOWN]
    first.save(out, save_all=True, append_images=others, duration=shown, optimize=True)


def picture_of_view(page: Path, out: Path, width: int, height: int, share: float) -> None:
    """Write what the browser view shows after a share of its time."""
    ready = "document.querySelector('[role=slider]')"
    # The word on software rendering is of this machine, not of the view.
    close = "document.querySelectorAll('.mantine-Notification-closeButton').forEach((one) => one.click())"
    track = """(() => {
      const box = document.querySelector(".mantine-Slider-track").getBoundingClientRect();
      return [box.left, box.top + box.height / 2, box.width];
    })()"""
    now = f"Math.abs({ready}.getAttribute('aria-valuenow') / {ready}.getAttribute('aria-valuemax') - {share})"

    async def act(browser: Browser) -> None:
        await browser.until(ready + " !== null")
        await browser.run("document.querySelector('button').click()")
        left, top, length = await browser.run(track)
        # A page that is busy drawing loses a click.
        while not await browser.run(f"{now} < 0.01"):
            await browser.click(left + share * length, top)
            await asyncio.sleep(1.0)
        await browser.run(close)
        await asyncio.sleep(3.0)
        await browser.picture(out)

    browse(page, width, height, act)


def picture_of_spy(log: Path, out: Path) -> None:
    """Write lcm-spy's window while it plays a log, with two of its messages open."""
    command, environment = spy_command(LOCAL_URL, log, 0.25)
    read, write = os.pipe()
    with TemporaryDirectory() as memory:
        screen = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", SPY_SCREEN, "-fbdir", memory],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as told:
            environment["DISPLAY"] = f":{told.readline().strip()}"
        window = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            _open_messages(environment, log)
            Image.fromarray(_pixels(Path(memory) / "Xvfb_screen0")).save(out)
        finally:
            for program in (window, screen):
                program.terminate()
                program.wait(30)


def _pixels(dump: Path) -> NDArray[np.uint8]:
    """Return what is on a screen of Xvfb, whose memory is a file in the format of xwd, shape (height, width, 3)."""
    content = dump.read_bytes()
    # Words of the header: its size, width and height of the screen, bytes of a line, number of colours (12 bytes each).
    size, width, height, line, colors = (int.from_bytes(content[4 * i : 4 * i + 4], "big") for i in (0, 4, 5, 12, 19))
    pixels = np.frombuffer(content, np.uint8, height * line, size + 12 * colors).reshape(height, line // 4, 4)
    return pixels[:, :width, 2::-1].copy()


def _open_messages(environment: dict[str, str], log: Path) -> None:
    def xdo(*words: object) -> str:
        ran = subprocess.run(
            ["xdotool", *map(str, words)],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
        return ran.stdout.strip()

    end = time.monotonic() + PATIENCE
    while not (found := xdo("search", "--name", log.name)) and time.monotonic() < end:
        time.sleep(0.5)
    # When the log has been played its rows stay where they are: sorted, 16 px high, below a line of titles.
    time.sleep(8.0)
    xdo("windowsize", found.split()[0], 1240, 200, "windowmove", found.split()[0], 0, 0)
    time.sleep(1.0)
    for place, (channel, row) in enumerate((("PLAN", 4), ("ACTUATOR_STATE", 1))):
        xdo("mousemove", 60, 28 + 16 * row, "click", "--repeat", 2, "--delay", 80, 1)
        time.sleep(4.0)
        for window in xdo("search", "--name", channel).split()[:1]:
            xdo("windowsize", window, 620, 500, "windowmove", window, 620 * place, 200)
    time.sleep(2.0)

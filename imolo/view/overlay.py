"""What stays on the screen wherever the camera looks: the names of the sessions, and their time."""

from collections.abc import Sequence
from html import escape

from imolo.campaigns.appearance import Appearance, swatch
from imolo.command_line.terminal import plain

STYLE = (
    "position:fixed;top:1rem;right:1rem;z-index:9;padding:.5rem .8rem;border-radius:8px;background:#ffffffd9;"
    "color:#1a1c20;font:14px/1.6 system-ui,sans-serif;font-variant-numeric:tabular-nums;pointer-events:none"
)
# viser's player counts the seconds that it plays, on its slider; SPEED makes those of the session of them. The field
# that shows the former is hidden.
CLOCK = """<style>.mantine-NumberInput-root { display: none; }</style><script>
setInterval(() => {
  const slider = document.querySelector("[role=slider]");
  const now = slider ? Number(slider.getAttribute("aria-valuenow")) * SPEED : 0;
  document.getElementById("imolo-time").textContent = `${now.toFixed(3)} s`;
}, 50);
</script>"""


def legend(names: Sequence[str], looks: Sequence[Appearance | None]) -> str:
    """Return a line for each session, as HTML: its colour and its name; names come from files and logs."""
    box = "display:inline-block;width:.75em;height:.75em;margin-right:.5em"
    return "".join(
        f'<div><i style="{box};{swatch(look)}"></i>{escape(plain(name))}</div>'
        for name, look in zip(names, looks, strict=True)
        if look is not None
    )


def with_overlay(html: str, names: Sequence[str], looks: Sequence[Appearance | None], speed: float) -> str:
    """Return viser's page with legend and time over it; `speed` is how many seconds of the session it plays in one."""
    box = f'<div style="{STYLE}"><b id="imolo-time"></b>{legend(names, looks)}</div>'
    head, end, tail = html.rpartition("</body>")
    return f"{head}{box}{CLOCK.replace('SPEED', repr(speed))}{end}{tail}"

"""The reference of the messages, from the .lcm files and the table of channels."""

import re
from collections.abc import Iterator

from imolo.inspect.definitions import definition_files
from imolo.messaging.channels import CHANNELS

STRUCT = re.compile(r"((?://.*\n)*)struct (\w+)\n\{\n(.*?)\n\}", re.DOTALL)


def page() -> str:
    """Return channels, and types with their fields, as Markdown."""
    return "\n".join([*_channels(), *(line for path in definition_files() for line in _type(path.read_text("utf-8")))])


def _channels() -> Iterator[str]:
    yield "## Channels\n\n| channel | type | rate | who speaks |\n|---|---|---|---|"
    for channel in CHANNELS.values():
        kind = channel.message_type.__name__
        yield f"| `{channel.name}` | [`{kind}`](#{kind}) | {channel.rate} | {channel.sender} |"
    yield ""


def _type(text: str) -> Iterator[str]:
    for about, name, body in STRUCT.findall(text):
        yield f"## {name}\n\n{_words(about)}\n\n| field | type | meaning |\n|---|---|---|"
        meaning = ""
        for line in map(str.strip, body.splitlines()):
            if line.startswith("//"):
                meaning += f"{line}\n"
            elif line:
                kind, field = line.rstrip(";").removeprefix("const ").split(" ", 1)
                yield f"| `{field}` | `{kind}` | {_words(meaning)} |"
                meaning = ""
        yield ""


def _words(comment: str) -> str:
    return " ".join(line.removeprefix("//").strip() for line in comment.splitlines()).replace("|", "\\|")

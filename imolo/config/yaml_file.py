"""YAML without its traps: what is there twice, looks like a number in YAML 1.1 alone, or has no bound is refused."""

import re
from pathlib import Path
from typing import Any

import yaml

from imolo.machine.files import read_bounded

MOST_BYTES = 1_000_000  # the resolved config of 320 motions has 20,000
MOST_CHARACTERS = 1_000_000  # of values and keys, each with 10 for itself, what an alias stands for counted each time
DEEPEST = 100
LINE_ENDS = "\x85\u2028\u2029"
MOST_QUOTED = 300  # [characters] of what is wrong

# The core schema of YAML 1.2 less octals and hexadecimals: 010, 0o10, 1:30, 1_000, yes and dates are texts.
_DIGITS = "[-+]?(0|[1-9][0-9]{0,99})"
_SCALARS = {
    "null": (r"~|null|Null|NULL|", "~nN\0"),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (_DIGITS, "-+0123456789"),
    "float": (rf"{_DIGITS}(\.[0-9]*)?([eE][-+]?[0-9]+)?|[-+]?\.[0-9]+([eE][-+]?[0-9]+)?", "-+.0123456789"),
    "float ": (r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", "-+."),
    "merge": (r"<<", "<"),
}

_KEYS = ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge")


class YamlError(ValueError):
    """A file is no YAML, or more than is read of it; one line that follows the name of the file."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason if len(reason) <= MOST_QUOTED else f"{reason[:MOST_QUOTED]} ...")


class _Loader(yaml.SafeLoader):
    size = 0
    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(event, "tag", None) not in (None, "!"):
            raise YamlError(f"is not YAML: a tag in {_line(event)}, {event.tag!r}; write the plain value")
        before = self.size
        self.depth += 1
        if self.depth > DEEPEST:
            raise YamlError(f"is nested deeper than {DEEPEST} in {_line(event)}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        if isinstance(event, yaml.AliasEvent):
            # As large as what it stands for; one within itself has no end.
            self.size += getattr(node, "size", MOST_CHARACTERS)
        elif node is not None:
            self.size += 10 + (len(node.value) if isinstance(node, yaml.ScalarNode) else 0)
            node.size = self.size - before  # type: ignore[attr-defined]
        if self.size > MOST_CHARACTERS:
            raise YamlError(
                f"holds more than {MOST_CHARACTERS} characters, what aliases stand for included; write less"
            )
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        first: dict[tuple[str, str], yaml.Node] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise YamlError(f"has a key in {_line(key)} that is no text; write a word before the colon")
            if key.tag not in _KEYS:
                raise YamlError(
                    f"has a key in {_line(key)} that is no text: {key.value!r} is {key.value}: Keys should be strings"
                )
            earlier = first.setdefault((key.tag, key.value), key)
            if earlier is not key:
                raise YamlError(f"has the key {key.value!r} twice, in {_line(earlier)} and {_line(key)}; delete one")
        return node


class _Dumper(yaml.SafeDumper):
    """Quotes what is a number in YAML 1.1 or here, and escapes line ends of Unicode, which PyYAML does not."""

    def represent_str(self, data: str) -> yaml.ScalarNode:
        style = '"' if set(data) & set(LINE_ENDS) else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style)


_Dumper.add_representer(str, _Dumper.represent_str)


_Loader.yaml_implicit_resolvers = {}  # none of YAML 1.1
for _kind, (_pattern, _starts) in _SCALARS.items():
    for _class in (_Loader, _Dumper):
        _tag = f"tag:yaml.org,2002:{_kind.strip()}"
        _class.add_implicit_resolver(_tag, re.compile(f"({_pattern})$"), [start.strip("\0") for start in _starts])


def load_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        OSError: It cannot be read, see `read_bounded`.
        YamlError: It is no YAML, has a key twice or a tag, or is too large.
    """
    content = read_bounded(path, MOST_BYTES)
    loader = None
    try:
        loader = _Loader(content)
        return loader.get_single_data()
    except YamlError:
        raise
    except (yaml.YAMLError, ValueError) as error:
        raise YamlError(f"is not YAML: {' '.join(str(error).split())}") from error
    finally:
        if loader is not None:
            loader.dispose()


def dump_yaml(content: Any) -> str:
    """Return plain values as YAML, which `load_yaml` reads as they were."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def _line(where: yaml.Node | yaml.Event) -> str:
    return f"line {where.start_mark.line + 1}" if where.start_mark else "an unknown line"

"""YAML files: what is there twice, is a number by YAML 1.1 alone or has no bound is refused in one line, in time."""

import os
import time
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from imolo.config.loading import load_config
from imolo.config.model import Model
from imolo.config.reading import read_model
from imolo.config.yaml_file import MOST_BYTES, YamlError, dump_yaml, load_yaml
from imolo.errors import ConfigError

GOOD = "backend: {name: mujoco}\n"
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 8)}]\n" for i in range(1, 20)
)


class Settings(Model):
    number: float = 0.0
    count: int = 0
    switch: bool = False
    text: str = ""
    pair: tuple[float, float] = (0.0, 0.0)


def refusal(path: Path, text: str, model: type[Model] | None = None) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_model(path, model, "") if model else load_config(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < len(str(path)) + 500
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (GOOD + "seed: 1\n" + GOOD, ("'backend' twice", "line 1 and line 3")),
        (GOOD + "simulation: {timestep: 1e-4,\n timestep: 2e-4}\n", ("'timestep' twice", "line 2 and line 3")),
        (GOOD + "campaign:\n  balls: 3\n  'balls': 4\n", ("'balls' twice", "line 3 and line 4")),
        (GOOD + "methods: {a: {}, b: {}, a: {}}\n", ("'a' twice",)),
    ],
)
def test_key_that_is_there_twice_is_named_with_both_lines(tmp_path: Path, text: str, parts: tuple[str, ...]) -> None:
    said = refusal(tmp_path / "e.yaml", text)
    assert all(part in said for part in parts), said


@pytest.mark.parametrize("value", ["yes", "on", "true", "1:30", "010", "0o10", "0x10", "1_000", "'5'", "2020-01-02"])
@pytest.mark.parametrize("key", ["number", "count"])
def test_what_is_no_decimal_number_is_no_number(tmp_path: Path, key: str, value: str) -> None:
    assert f"'{key}' is " in refusal(tmp_path / "s.yaml", f"{key}: {value}\n", Settings)


@pytest.mark.parametrize("value", ["yes", "off", "1", "0", "'true'", "y"])
def test_only_true_and_false_are_booleans(tmp_path: Path, value: str) -> None:
    assert "write true or false" in refusal(tmp_path / "s.yaml", f"switch: {value}\n", Settings)


def test_options_of_a_backend_take_no_booleans_as_numbers(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text("backend: {name: mujoco, impratio: true}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="'impratio' is True: Input should be a valid number"):
        load_config(path)


class Part(Model):
    name: str
    until: float | None = None


class Whole(Model):
    parts: Annotated[tuple[Annotated[Part, Field()], ...], Field(min_length=1)]
    mixed: tuple[Part | str, ...] = ()
    by_name: dict[str, tuple[Part, ...]] = Field({})
    pair: tuple[float, Part] | None = None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("parts: [{name: a, untill: 1.0}]", "unknown key 'parts.0.untill'; did you mean 'until'? (known: name, until)"),
        ("parts: [{nam: a}]", "unknown key 'parts.0.nam'; did you mean 'name'? (known: name, until)"),
        ("parts: [{name: a}, {nam: a}]", "unknown key 'parts.1.nam'; did you mean 'name'? (known: name, until)"),
        ("parts: []", "'parts' is []: List should have at least 1 item after validation, not 0"),
        ("parts: [{until: 1.0}]", "'parts.0.name' is missing"),
        ("parts: [{name: a}]\nmixed: [{name: b, untill: 1.0}]", "unknown key 'mixed.0.untill'; did you mean 'until'?"),
        ("parts: [{name: a}]\nmixed: [x, 3.0]", "'mixed.1' is 3.0: "),
        (
            "parts: [{name: a}]\nby_name: {b: [{name: b, untill: 1.0}]}",
            "unknown key 'by_name.b.0.untill'; did you mean",
        ),
        (
            "parts: [{name: a}]\npair: [1.0, {name: b, untill: 1.0}]",
            "unknown key 'pair.1.untill'; did you mean 'until'?",
        ),
    ],
)
def test_one_mistake_in_a_list_is_told_as_one(tmp_path: Path, text: str, told: str) -> None:
    said = refusal(tmp_path / "s.yaml", text, Whole)
    assert told.replace("List", "Tuple") in said or told in said
    assert " more)" not in said


@pytest.mark.parametrize(
    ("text", "more"),
    [
        ("parts: [{name: a, x: 1}, {name: b, y: 1}]", 1),
        ("parts: [{name: a, x: 1, until: soon}]\nmixed: 3", 2),
        ("parts: [{x: 1}]", 1),  # the name is missing, and not misspelt
        ("parts: [{nam: a}, {nam: b}]", 1),
    ],
)
def test_as_many_more_mistakes_are_counted_as_there_are(tmp_path: Path, text: str, more: int) -> None:
    said = refusal(tmp_path / "s.yaml", text, Whole)
    assert "unknown key" in said
    assert said.endswith(f" (and {more} more)")


def test_misspelt_key_of_a_phase_is_named(tmp_path: Path) -> None:
    text = GOOD + "motion: {phases: [{target: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], untill: 1.2}]}\n"
    said = refusal(tmp_path / "e.yaml", text)
    assert said.endswith("unknown key 'motion.phases.0.untill'; did you mean 'until'? (known: target, until)")


def test_plain_words_and_numbers_mean_what_they_say(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("base: &b {number: 1e-4, count: +7}\n", encoding="utf-8")
    assert load_yaml(path) == {"base": {"number": 1e-4, "count": 7}}
    path.write_text("number: 2\ncount: 7\nswitch: True\ntext: no\npair: [.5, -1.5E3]\n", encoding="utf-8")
    read = read_model(path, Settings, "")
    assert read == Settings(number=2.0, count=7, switch=True, text="no", pair=(0.5, -1500.0))


def test_anchors_and_merges_are_read(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("a: &a {p: 1, q: 2}\nb: {<<: *a, q: 3}\nc: [*a, *a]\n", encoding="utf-8")
    one = {"p": 1, "q": 2}
    assert load_yaml(path) == {"a": one, "b": {"p": 1, "q": 3}, "c": [one, one]}


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
TRAPS = [
    "1e5",
    "yes",
    "010",
    "1:30",
    "0x1",
    "~",
    "<<",
    "=",
    "",
    "2020-01-01",
    "true",
    "1_000",
    ".5",
    ".inf",
    "5.",
    "\x85",
    "\u2028",
]


@given(content=PLAIN | st.lists(st.sampled_from(TRAPS)))
def test_what_is_written_is_read_as_it_was(tmp_path_factory: pytest.TempPathFactory, content: object) -> None:
    path = tmp_path_factory.mktemp("yaml") / "c.yaml"
    path.write_text(dump_yaml(content), encoding="utf-8", newline="")
    read = load_yaml(path)
    assert read == content
    assert repr(read) == repr(content)


@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        "a: &a [*a]\n",
        "a: &a {b: *a}\n",
        f"a: &a '{'x' * 100_000}'\nb: [{', '.join(['*a'] * 1000)}]\n",
        "[" * 100_000,
        "{a: " * 100_000,
        "- " * 100_000,
        "".join(f"{' ' * i}a:\n" for i in range(1000)),
        "- a\n" * 240_000,
        "seed: !!int 010\n",
        "seed: !!bool yes\n",
        "? [1, 2]\n: 3\n",
        f"{'k' * 10_000}: 1\n{'k' * 10_000}: 1\n",
        f"backend: {'x' * 100_000}\n",
        f"{GOOD}{'k' * 10_000}: 1\n",
        "#" * (MOST_BYTES + 1),
    ],
    ids=range(16),
)
def test_file_without_a_bound_is_refused_in_one_short_line_and_seconds(tmp_path: Path, text: str) -> None:
    # Of this process, so that other programs do not count; an unbounded one takes 40 s or all memory.
    began = time.process_time()
    refusal(tmp_path / "e.yaml", text)
    assert time.process_time() - began < 20.0


def test_pipes_and_devices_are_refused_before_they_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ConfigError, match="a pipe or a device; give a file"):
            load_config(path)


def test_large_sparse_file_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "e.yaml").open("wb") as file:
        file.truncate(4 << 30)
    with pytest.raises(ConfigError, match="larger than the 1 MB"):
        load_config(tmp_path / "e.yaml")


@given(content=st.binary(max_size=200) | st.text(alphabet="a:-[]{}&*!|>'\"#\n ,?%@`01", max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes | str) -> None:
    path = tmp_path_factory.mktemp("yaml") / "c.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    said = ""
    try:
        load_yaml(path)
    except YamlError as error:
        said = str(error)
    assert "\n" not in said


@pytest.mark.parametrize("name", ["../escaped", "a/b", "..", ".hidden", "", "a\\nb", "x" * 64, "-o"])
def test_method_cannot_be_named_like_a_path(tmp_path: Path, name: str) -> None:
    assert "methods." in refusal(tmp_path / "e.yaml", f'{GOOD}methods: {{"{name}": {{}}}}\n')


@pytest.mark.parametrize("name", ["paper", "improved 2", "größer", "a.b-c+d_e"])
def test_method_may_have_any_plain_name(tmp_path: Path, name: str) -> None:
    (tmp_path / "e.yaml").write_text(f"{GOOD}methods: {{{name}: {{}}}}\n", encoding="utf-8")
    assert list(load_config(tmp_path / "e.yaml").methods) == [name]

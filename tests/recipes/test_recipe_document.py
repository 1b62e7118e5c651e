"""Documents read into models: what is accepted, and where and how everything else is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from irpmd_rig.recipes.document import (
    DocumentError,
    Problem,
    Settings,
    check_document,
    complaint,
    locate,
    parse_document,
    problem_at,
    read_document,
)


class _Lamp(Settings):
    colour: str
    power: Annotated[float, Field(ge=0, le=1)] = 0.5


class _Walk(Settings):
    do: Literal["walk"]
    far_mm: float


class _Rest(Settings):
    do: Literal["rest"]
    time_s: Annotated[float, Field(ge=0)]


class _Model(Settings):
    name: str
    steps: Annotated[int, Field(ge=3)] = 4
    exposure_us: Annotated[float, Field(gt=0)] | Literal["auto"] = "auto"
    on: bool = True
    counts: Annotated[tuple[float, ...], Field(min_length=1)] = (1.0,)
    lamp: _Lamp | None = None
    path: tuple[Annotated[_Walk | _Rest, Field(discriminator="do")], ...] = ()


def _problems(text: str) -> tuple[Problem, ...]:
    with pytest.raises(DocumentError) as caught:
        read_document(text, _Model, "r.yaml")
    return caught.value.problems


def _told(text: str) -> list[str]:
    return [str(problem) for problem in _problems(text)]


def _only(text: str) -> Problem:
    problems = _problems(text)
    assert len(problems) == 1, problems
    return problems[0]


def test_plain_values_become_a_frozen_model() -> None:
    text = (
        "name: 'no'   # quoted\nsteps: 8\nexposure_us: 1e3\non: false\ncounts: [64, 63.0, .5]\n"
        "lamp:\n  colour: red\npath:\n- do: walk\n  far_mm: -4\n- {do: rest, time_s: 0}\n"
    )
    model = read_document(text, _Model)
    assert model.name == "no"
    assert (model.steps, model.exposure_us, model.on, model.counts) == (8, 1000.0, False, (64.0, 63.0, 0.5))
    assert model.lamp == _Lamp(colour="red")
    assert model.path == (_Walk(do="walk", far_mm=-4.0), _Rest(do="rest", time_s=0.0))
    with pytest.raises(ValueError, match="frozen"):
        model.name = "x"  # type: ignore[misc]


def test_all_that_is_wrong_is_told_at_once_in_order() -> None:
    text = (
        "steps: 4.0\nexposur_us: 5\nlamp:\n  colour: 3\n  powr: 1\non: no\ncounts: [64, x, .nan]\n"
        "path:\n - {do: walk, far_mm: 1, speed: 2}\n - {do: wlk}\n - {time_s: 3}\nsteps: 9\n"
    )
    assert _told(text) == [
        "r.yaml:1:1: 'name' is missing; add name",
        "r.yaml:1:8: 'steps' must be a whole number, not 4.0; write a whole number without a decimal point",
        "r.yaml:2:1: unknown key 'exposur_us'; did you mean 'exposure_us'? known are: counts, exposure_us, lamp, name, "
        "on, path, steps",
        "r.yaml:4:11: 'lamp.colour' must be text, not 3; write text; put numbers and words like true in quotes",
        "r.yaml:5:3: unknown key 'lamp.powr'; did you mean 'power'? known are: colour, power",
        "r.yaml:6:5: 'on' must be true or false, not 'no'; write true or false",
        "r.yaml:7:14: 'counts[1]' must be a number, not 'x'; write a number without quotes or unit",
        "r.yaml:7:17: .nan is no finite number; give a number",
        "r.yaml:9:26: unknown key 'path[0].speed'; known are: do, far_mm",
        "r.yaml:10:9: 'path[1].do' is unknown: 'wlk'; did you mean 'walk'? known are: rest, walk",
        "r.yaml:11:4: 'path[2].do' is missing; add do",
        "r.yaml:12:1: the key 'steps' is there twice; leave one of them out",
    ]


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("name: a\nname: b", (2, 1), "twice"),
        ("{name: a, 'name': b}", (1, 11), "twice"),
        ("name: &x a", (1, 7), "anchors"),
        ("name: *x", (1, 7), "anchors"),
        ("name: a\n<<: {steps: 3}", (2, 1), "merge keys"),
        ("name: !!str 3", (1, 7), "tags"),
        ("name: !thing a", (1, 7), "tags"),
        ("name: ! a", (1, 7), "tags"),
        ("name: !!python/object/apply:os.system [true]", (1, 7), "tags"),
        ("? [a]\n: 1\nname: x", (1, 3), "no plain text"),
        ("? {a: [b]}\n: {c: d}\nname: x", (1, 3), "no plain text"),
        ("~: 1\nname: x", (1, 1), "key is missing"),
        ("%YAML 1.1\n---\nname: no", (2, 1), "directives"),
        ("name: a\n---\nname: b", (2, 1), "second document"),
        ("name: a\n\tsteps: 3", (2, 1), "tab"),
        ("name: a\nsteps:\t3", (2, 7), "tab"),
        ("name: a: b", (1, 8), "no YAML"),
        ("name: [a", (1, 9), "no YAML"),
        ("name: 'a", (1, 9), "no YAML"),
        ('name: "\\q"', (1, 9), "no YAML"),
        ('name: "\\U00110000"', (1, 1), "cannot be read"),
        ('name: "\\ud800"', (1, 7), "control character"),
        ('name: "a\\0"', (1, 7), "control character"),
        ('name: "\\e[2J"', (1, 7), "control character"),
        ('"\\e[2J": 3\nname: a', (1, 1), "control character"),
        ("name: a\x00b", (1, 8), "'\\x00' is not accepted"),
        ("name: a\nsteps: \ud800", (2, 8), "'\\ud800' is not accepted"),
        ("", (1, 1), "is empty"),
        ("# nothing but a remark\n", (1, 1), "is empty"),
        ("---\n...\n", (2, 1), "is empty"),
        ("- a\n- b", (1, 1), "is no mapping"),
        ("  just words", (1, 3), "is no mapping"),
        ("null", (1, 1), "is empty"),
        ("name: a\nsteps: 012", (2, 8), "octal"),
        ("name: a\nsteps: 1:30", (2, 8), "must be a whole number, not '1:30'"),
        ("name: a\nsteps: 1_000", (2, 8), "must be a whole number, not '1_000'"),
        ("name: a\nsteps: '4'", (2, 8), "must be a whole number, not '4'"),
        ("name: a\nsteps: true", (2, 8), "must be a whole number, not true"),
        ("name: a\nsteps:", (2, 7), "must be a whole number; it is empty"),
        ("name: a\nsteps: 2", (2, 8), "must be at least 3, not 2"),
        ("name: a\nsteps: " + "9" * 5000, (2, 8), "5000 digits"),
        ("name: 2020-13-45\nsteps: -_", (2, 8), "must be a whole number"),
        ("name: a\nexposure_us: .inf", (2, 14), "no finite number"),
        ("name: a\nexposure_us: -.INF", (2, 14), "no finite number"),
        ("name: a\nexposure_us: 1e999", (2, 14), "too large"),
        ("name: a\nexposure_us: -1", (2, 14), "must be above 0 or 'auto', not -1"),
        ("name: a\nexposure_us: 10 ms", (2, 14), "must be a number or 'auto', not '10 ms'"),
        ("name: a\nexposure_us: true", (2, 14), "must be a number or 'auto', not true"),
        ("name: a\ncounts: 64", (2, 9), "must be a list, not 64"),
        ("name: a\ncounts: []", (2, 9), "must be a list of at least 1 item"),
        ("name: a\ncounts: [x]", (2, 10), "must be a number"),
        ("name: a\nlamp: 3", (2, 7), "must be a mapping, not 3"),
        ("name: a\nlamp: [red]", (2, 7), "must be a mapping"),
        ("name: 3", (1, 7), "must be text, not 3"),
        ("name: " + "[" * 50, (1, 18), "nested deeper"),
        ("- " * 50 + "x", (1, 25), "nested deeper"),
    ],
)
def test_refusal_names_its_place(text: str, place: tuple[int, int], what: str) -> None:
    problem = _only(text)
    assert (problem.line, problem.column) == place
    assert what in problem.what
    assert problem.remedy


@pytest.mark.parametrize(
    ("written", "value"),
    [("no", "no"), ("1:30", "1:30"), ("2020-01-01", "2020-01-01"), ("yes", "yes"), ("=", "="), ("0b11", "0b11")],
)
def test_words_that_older_readers_turn_into_something_else_stay_text(written: str, value: str) -> None:
    assert read_document(f"name: {written}", _Model).name == value


@pytest.mark.parametrize(
    ("written", "value"), [("0x1F", 31), ("0o17", 15), ("+7", 7), ("-0", 0), ("~", None), ("True", True), ("1.", 1.0)]
)
def test_scalars_of_the_core_schema(written: str, value: object) -> None:
    read = parse_document(f"a: {written}").values["a"]
    assert read == value
    assert type(read) is type(value)


def test_aliases_do_not_expand() -> None:
    bomb = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
        f"{chr(98 + k)}: &{chr(98 + k)} [" + ",".join([f"*{chr(97 + k)}"] * 9) + "]\n" for k in range(9)
    )
    assert {problem.what for problem in _problems(bomb)} >= {"anchors and aliases (&, *) are not accepted"}


def test_refused_value_is_told_once() -> None:
    assert [problem.what for problem in _problems("name: &a x\nsteps: 012\nlamp: !x {colour: 3}")] == [
        "anchors and aliases (&, *) are not accepted",
        "012 begins with 0, which some readers take as octal",
        "tags (!) are not accepted",
    ]


def test_size_is_limited() -> None:
    assert "larger than" in _only("name: " + "a" * 100_000).what
    # Bytes, not characters.
    assert "larger than" in _only("name: " + "é" * 60_000).what


def test_endless_lists_of_problems_are_cut() -> None:
    problems = _problems("".join(f"k{k}: 1\n" for k in range(1000)))
    assert len(problems) == 100
    assert problems[-1].what == "902 further problems are not listed"


def test_file_is_named_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "r.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: a\r\nsteps: 5\r\n")
    assert read_document(path, _Model).steps == 5
    path.write_text("name: a\nstep: 5\n")
    with pytest.raises(DocumentError, match=r"r\.yaml:2:1: unknown key 'step'; did you mean 'steps'\?"):
        read_document(path, _Model)
    with pytest.raises(DocumentError, match=r"^mine:2:1"):
        read_document(path, _Model, "mine")


@pytest.mark.parametrize(
    ("content", "place", "what"),
    [
        (b"name: a\nsteps: \xff", (2, 8), "byte 0xFF is not UTF-8"),
        ("name: a".encode("utf-16"), (1, 1), "byte 0xFF is not UTF-8"),
        (b"name: a" * 20_000, (1, 1), "larger than"),
        (b"\x00" * 10, (1, 1), "is not accepted"),
    ],
)
def test_bad_bytes(tmp_path: Path, content: bytes, place: tuple[int, int], what: str) -> None:
    path = tmp_path / "r.yaml"
    path.write_bytes(content)
    with pytest.raises(DocumentError) as caught:
        read_document(path, _Model)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column) == place
    assert what in problem.what


def test_what_is_no_file(tmp_path: Path) -> None:
    for path, what in (
        (tmp_path, "is no file"),
        (tmp_path / "none.yaml", "No such file"),
        (Path("/dev/zero"), "is no file"),
        (Path("a\x00b"), "cannot be read"),
        (tmp_path / ("x" * 300), "cannot be read"),
    ):
        with pytest.raises(DocumentError, match=what):
            read_document(path, _Model)


def test_places_for_later_problems() -> None:
    document = parse_document("name: a\nlamp:\n  colour: red\ncounts: [1,\n  2]\n", "r")
    model = check_document(document, _Model)
    assert model.counts == (1.0, 2.0)
    assert locate(document, ("lamp", "colour")) == (3, 11)
    assert locate(document, ("counts", 1)) == (5, 3)
    # What is not written is placed where it would be.
    assert locate(document, ("lamp", "power")) == (3, 3)
    assert locate(document, ("steps",)) == (1, 1)
    assert str(problem_at(document, ("counts", 0), "is odd", "double it")) == "r:4:10: is odd; double it"


def test_complaints_of_validators_keep_their_remedy_and_place() -> None:
    class Pair(Settings):
        ends: tuple[float, ...]

        def model_post_init(self, context: object) -> None:
            del context
            if self.ends[0] == self.ends[1]:
                raise complaint("equals the other end", "give another", ("ends", 1))

    class Outer(Settings):
        pair: Pair

    with pytest.raises(DocumentError) as caught:
        read_document("pair: {ends: [1, 1]}", Outer, "r")
    assert str(caught.value) == "r:1:18: 'pair.ends[1]' equals the other end; give another"


_WORDS = st.text(st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp", "Cn")), max_size=20)
_JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=False, allow_infinity=False)
    | _WORDS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_WORDS, inner, max_size=4),
    max_leaves=12,
)


@settings(deadline=None)
@given(st.dictionaries(_WORDS, _JSON, max_size=5))
def test_json_is_read_as_json_readers_do(values: dict[str, object]) -> None:
    document = parse_document(json.dumps(values, ensure_ascii=False))
    assert document.problems == ()
    assert json.loads(json.dumps(document.values)) == json.loads(json.dumps(values))

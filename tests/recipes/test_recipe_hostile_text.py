"""Whatever the text, reading gives a model or a DocumentError with places in that text, and soon."""

from __future__ import annotations

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.recipes.plan import Equipment, check, estimate, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.shipped import shipped_recipes

_SHIPPED = [path.read_text() for path in shipped_recipes().values()]
_SIGNS = "\t\n\r :-?,[]{}#&*!|>'\"%@`<=~.0123456789_eExon\\\x00\x1b\x85\u2028\ufeff\ud800é😀"
_SCRAPS = [
    "<<: *a\n", "&a ", "*a", "!!int ", "---\n", "...\n", "%YAML 1.1\n", "? ", "- ", "|\n  ", ">-\n ", ".nan", "-.inf",
    "1:30", "012", "0x_", "._", "kind: measure\n", "steps:\n", "  - {do: show, pattern: fringes}\n",
    "positions_mm: [0, 0]\n",
    "fringes: {counts: [64, 62], steps: 4.0}\n", "\n\t", "[" * 30, "{a: " * 30, '"\\U00110000"', "exposure_us: -1\n",
]  # fmt: skip


def _read(text: str) -> None:
    try:
        recipe, document = read_recipe(text, "r")
    except DocumentError as error:
        problems = error.problems
    else:
        stations = plan(recipe)
        assert stations.stations
        check(recipe, stations, Equipment(), document)
        estimate(recipe, stations, Equipment())
        return
    lines = 1 + sum(text.count(end) for end in "\n\r\x85\u2028\u2029")
    assert problems
    for problem in problems:
        assert 1 <= problem.line <= lines + 1
        assert 1 <= problem.column <= len(text) + 2
        assert problem.what
        assert problem.remedy
        assert "\x1b" not in str(problem)


@settings(deadline=None)
@given(st.text())
def test_any_text(text: str) -> None:
    _read(text)


@settings(deadline=None)
@given(st.text(_SIGNS, max_size=60))
def test_any_text_of_yaml_signs(text: str) -> None:
    _read(text)


@settings(deadline=None)
@given(st.lists(st.sampled_from(_SCRAPS) | st.text(_SIGNS, max_size=4), max_size=12).map("".join))
def test_any_mixture_of_scraps(text: str) -> None:
    _read(text)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(_SHIPPED), st.data())
def test_any_damage_to_a_recipe(text: str, data: st.DataObject) -> None:
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.sampled_from(_SCRAPS) | st.text(_SIGNS, max_size=6)) + text[end:]
    _read(text)


_BOMBS = {
    "brackets": "[" * 99_000,
    "braces": "{" * 99_000,
    "dashes": "- " * 49_000,
    "questions": "? " * 49_000,
    "unknown keys": "kind: measure\n" + "".join(f"k{k}: 1\n" for k in range(5_000)),
    "wrong steps": "kind: sequence\nsteps:\n" + "- {do: show, pattern: {}}\n" * 1000,
    "the same key": "a: 1\n" * 4_000,
    "flow": "name: [" + "1," * 45_000 + "]",
    "blanks": " " * 99_000 + "x",
    "quotes": "'" * 99_000,
    "digits": "a: " + "1" * 99_000,
    "comment": "#" * 99_000,
}


@pytest.mark.parametrize("name", _BOMBS)
def test_heavy_text_is_read_within_bounds(name: str) -> None:
    started = time.monotonic()
    _read(_BOMBS[name])
    assert time.monotonic() - started < 30

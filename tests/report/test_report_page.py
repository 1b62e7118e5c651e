"""A page: it holds everything, loads nothing, and runs nothing but the one script of ours."""

import base64
import hashlib
import re
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from pages import Parts

from irpmd_rig.report.content import (
    Check,
    Checks,
    Facts,
    Files,
    Page,
    Picture,
    Section,
    Source,
    Table,
    Text,
    Turnable,
    Verdict,
)
from irpmd_rig.report.figures_graphs import bars
from irpmd_rig.report.html import render
from irpmd_rig.report.mesh import mesh_of
from irpmd_rig.report.policy import VIEWER

EVIL = "</script><script>alert(1)</script><img src=http://evil.example/x onerror=alert(1)> \"'&"
Y, X = np.mgrid[:20, :30].astype(float)


def figure() -> Figure:
    return bars([EVIL[:20], "b"], [1.0, 2.0], y_label=EVIL)


@pytest.fixture(scope="module")
def text() -> str:
    mesh = mesh_of(np.dstack([X, Y, X]))
    blocks = (
        Text(EVIL),
        Source(EVIL),
        Facts(((EVIL, "1 mm"),)),
        Table(("name", "value (mm)", "told"), (("a", "-1.25 ± 0.30", EVIL), ("b", "-", "")), EVIL),
        Checks((Check("good", True, ""), Check("bad", False, EVIL), Check("open", None, "why"))),
        Picture("graph", figure(), EVIL, EVIL),
        Turnable(mesh, Picture("still", figure(), "a surface", "turn it")),
        Files(("result.json",)),
    )
    sections = (Section(EVIL, blocks), Section("folded", (Text("within"),), folded=True))
    return render(Page(EVIL, EVIL, Verdict(False, EVIL, EVIL), sections))


@pytest.fixture(scope="module")
def parts(text: str) -> Parts:
    return Parts(text)


def test_what_it_is_given_stays_text(parts: Parts):
    assert len(parts.all("script")) == 2  # the surface's numbers and the viewer
    assert all("onerror" not in attributes for attributes in parts.all("img"))
    assert sum(EVIL.strip() in told for told in parts.texts) >= 8


def test_nothing_is_loaded_from_elsewhere(text: str, parts: Parts):
    for tag in ("link", "iframe", "object", "embed", "base", "form", "video", "audio"):
        assert not parts.all(tag)
    for attributes in parts.all("img"):
        assert attributes["src"].startswith("data:image/svg+xml,")
    assert [attributes.get("src") for attributes in parts.all("script")] == [None, None]
    assert {a["href"][:1] for a in parts.all("a")} == {"#", "r"}
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)[1]
    assert "url(" not in style
    assert "@import" not in style
    for word in ("fetch(", "XMLHttpRequest", "import(", "WebSocket", "sendBeacon", ".src ="):
        assert word not in VIEWER


def test_the_policy_lets_only_the_viewer_run(text: str, parts: Parts):
    policy = next(a["content"] for a in parts.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert scripts == [VIEWER]
    told = re.search(r"script-src 'sha256-([^']+)'", policy)[1]
    assert base64.b64decode(told) == hashlib.sha256(scripts[0].encode()).digest()
    assert next(a for a in parts.all("script") if a.get("class") == "mesh")["type"] == "application/json"


def test_pictures_are_whole_drawings_with_words_for_them(parts: Parts):
    pictures = parts.all("img")
    assert [picture["alt"] for picture in pictures] == [EVIL, "a surface"]
    for picture in pictures:
        root = ElementTree.fromstring(unquote(picture["src"].removeprefix("data:image/svg+xml,")))
        assert root.tag.endswith("svg")


def test_the_verdict_comes_first_and_in_words(text: str, parts: Parts):
    assert text.index('class="verdict bad"') < text.index("<main>")
    marks = [a["aria-label"] for a in parts.all("span") if a.get("class") == "mark"]
    assert marks == ["not passed", "passed", "not passed", "not decided"]


def test_a_page_can_be_walked_through(parts: Parts):
    assert parts.all("html") == [{"lang": "en"}]
    ids = {a["id"] for _, a in parts.elements if "id" in a}
    assert {a["href"].removeprefix("#") for a in parts.all("a") if a["href"].startswith("#")} <= ids
    assert len(parts.all("h1")) == 1
    assert all(a.get("scope") in ("col", "row") for a in parts.all("th"))
    assert next(a for a in parts.all("canvas") if a.get("role") == "img")["tabindex"] == "0"
    assert len(parts.all("details")) == 1


def test_numbers_stand_right_aligned(text: str):
    assert '<td class="number">-1.25 ± 0.30</td>' in text
    assert '<td class="number">-</td>' in text
    assert '<th scope="col" class="number">value (mm)</th>' in text

"""A page as HTML: one text that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from irpmd_rig.report.content import Page, Table
from irpmd_rig.report.drawing import svg
from irpmd_rig.report.policy import POLICY, VIEWER

_NUMBER = re.compile(r"[+-]?[\d.]+([eE][+-]?\d+)?(\s*±\s*[\d.]+)?\s*%?|-|")
# What may not stand as it is in a data URL in an attribute: much shorter than base64 of pictures in base64.
_CODED = tuple((letter, f"%{ord(letter):02X}") for letter in '%#&"<>\n\r\t')


def render(page: Page, drawn: Mapping[str, str] | None = None) -> str:
    """Page as one HTML document: pictures, styles, script and surfaces are in it; no request leaves it.

    Parameters
    ----------
    page
        What is on it.
    drawn
        SVG documents by picture name, for those that are drawn already.
    """
    pictures = dict(drawn) if drawn is not None else drawings(page)
    urls = {name: Markup(_data_url(document)) for name, document in pictures.items()}
    return _template().render(page=page, policy=POLICY, viewer=Markup(VIEWER), urls=urls)


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("irpmd_rig.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["numeric"] = _numeric
    environment.tests["of_kind"] = _of_kind
    return environment.get_template("page.html")


def _numeric(table: Table) -> list[bool]:
    """For each column but the first, which names the row: whether all in it are numbers."""
    columns = zip(*table.rows, strict=True)
    return [place > 0 and all(map(_NUMBER.fullmatch, cells)) for place, cells in enumerate(columns)]


def _of_kind(block: Any, kind: str) -> bool:
    return type(block).__name__ == kind


def drawings(page: Page) -> dict[str, str]:
    """SVG documents of all figures of a page, by their names."""
    return {picture.name: svg(picture.figure) for picture in page.pictures}


def _data_url(document: str) -> str:
    """SVG as a URL, from its element on: a declaration and a document type say nothing to a browser."""
    coded = document[document.index("<svg") :]
    # Ten times as fast as translating letter by letter: there are millions of them.
    for letter, code in _CODED:
        coded = coded.replace(letter, code)
    return f"data:image/svg+xml,{coded}"

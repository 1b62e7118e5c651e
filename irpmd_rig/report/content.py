"""What a page is made of, before it is HTML."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

from irpmd_rig.report.mesh import Mesh


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the page has to say, in one line: the first thing on it.

    Attributes
    ----------
    passed
        Whether everything was found good; None: nothing was to be decided.
    headline
        The answer.
    told
        A sentence more.
    """

    passed: bool | None
    headline: str
    told: str = ""


@dataclass(frozen=True, slots=True)
class Check:
    """Something that was looked at.

    Attributes
    ----------
    name
        What.
    passed
        Whether it was found good; None: it could not be looked at.
    told
        What was found, beside its limit.
    """

    name: str
    passed: bool | None
    told: str


@dataclass(frozen=True, slots=True)
class Checks:
    """All that was looked at."""

    checks: tuple[Check, ...]


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True, slots=True)
class Source:
    """A text as it is, e.g. a recipe."""

    text: str


@dataclass(frozen=True, slots=True)
class Facts:
    """Names and values with their units."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table; cells that are numbers stand right-aligned.

    Attributes
    ----------
    columns
        Heads, with units.
    rows
        Cells of each row; the first names the row.
    caption
        What the table shows.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of the page, which is a file of its own as well.

    Attributes
    ----------
    name
        Of that file, without suffix.
    figure
        The figure.
    alt
        What it shows, for those who do not see it.
    caption
        Below it.
    """

    name: str
    figure: Figure
    alt: str
    caption: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Turnable:
    """A surface that can be turned.

    Attributes
    ----------
    mesh
        The surface.
    still
        The picture that stands for it on paper, and where it cannot be turned.
    """

    mesh: Mesh
    still: Picture


@dataclass(frozen=True, slots=True)
class Files:
    """Names of files that lie beside the page."""

    names: tuple[str, ...]


Block = Checks | Text | Source | Facts | Table | Picture | Turnable | Files


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page under one heading.

    Attributes
    ----------
    heading
        Of the section.
    blocks
        From top to bottom.
    folded
        Whether it is to be opened first: what few people look for.
    """

    heading: str
    blocks: tuple[Block, ...]
    folded: bool = False


@dataclass(frozen=True, slots=True)
class Page:
    """A whole page.

    Attributes
    ----------
    title, subtitle
        What it is about; when and with what.
    verdict
        First thing on the page.
    sections
        From top to bottom.
    """

    title: str
    subtitle: str
    verdict: Verdict
    sections: tuple[Section, ...]

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """All figures, from top to bottom."""
        blocks = [block for section in self.sections for block in section.blocks]
        shown = (block.still if isinstance(block, Turnable) else block for block in blocks)
        return tuple(block for block in shown if isinstance(block, Picture))

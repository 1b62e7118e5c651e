"""Recipes read from text, file or shipped name."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from pydantic import ConfigDict

from irpmd_rig.recipes.base import RecipeBase
from irpmd_rig.recipes.document import (
    Document,
    DocumentError,
    Problem,
    check_document,
    nearest,
    parse_document,
    problem_at,
)
from irpmd_rig.recipes.models import KINDS, Recipe, model_of


def read_recipe(source: str | Path, name: str | None = None) -> tuple[Recipe, Document]:
    """Read a recipe.

    Parameters
    ----------
    source
        The YAML text itself, or the path of a file.
    name
        What problems call it; a file's path if not given.

    Returns
    -------
    recipe, document
        The recipe, and what it was read from (its text, and lines for later problems).

    Raises
    ------
    DocumentError
        All that is wrong, each with line, column and remedy.
    """
    document = parse_document(source, name)
    kind = document.values.get("kind")
    if isinstance(kind, str) and kind in KINDS:
        return cast(Recipe, check_document(document, model_of(document.values))), document
    if kind is not None and not isinstance(kind, str):
        what, remedy = "'kind' must be text", "use one of " + ", ".join(KINDS)
    elif kind is None:
        what, remedy = "'kind' is missing", "add kind: " + ", ".join(KINDS)
    else:
        what, remedy = f"there is no kind {kind!r}"[:100], nearest(kind, KINDS)
    if document.refused(("kind",)):
        raise DocumentError(_common_problems(document))
    raise DocumentError([*_common_problems(document), problem_at(document, ("kind",), what, remedy)])


class _Common(RecipeBase):
    model_config = ConfigDict(extra="ignore")


def _common_problems(document: Document) -> tuple[Problem, ...]:
    """What is wrong whatever the kind."""
    try:
        check_document(document, _Common)
    except DocumentError as error:
        return error.problems
    return ()

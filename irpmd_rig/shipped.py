"""Configuration files that ship with the package."""

from __future__ import annotations

from pathlib import Path

# In a wheel the folder lies inside the package, in a checkout beside it.
_PACKAGE = Path(__file__).parent
CONFIGS = next(folder for folder in (_PACKAGE / "configs", _PACKAGE.parent / "configs") if folder.is_dir())


def shipped_worlds() -> dict[str, Path]:
    """Shipped worlds by name."""
    return {path.stem: path for path in sorted((CONFIGS / "worlds").glob("*.yaml"))}


def world_file(name_or_path: str) -> Path:
    """File of a world given by path or by the name of a shipped one.

    Raises
    ------
    FileNotFoundError
        If there is neither; the message lists the shipped names.
    """
    return _found("world", name_or_path, shipped_worlds())


def shipped_rigs() -> dict[str, Path]:
    """Shipped rig files by name."""
    return {path.stem: path for path in sorted((CONFIGS / "rigs").glob("*.yaml"))}


def rig_file(name_or_path: str) -> Path:
    """File of a rig given by path or by the name of a shipped one.

    Raises
    ------
    FileNotFoundError
        If there is neither; the message lists the shipped names.
    """
    return _found("rig", name_or_path, shipped_rigs())


def shipped_recipes() -> dict[str, Path]:
    """Shipped recipes by name."""
    return {path.stem: path for path in sorted((CONFIGS / "recipes").glob("*.yaml"))}


def recipe_file(name_or_path: str) -> Path:
    """File of a recipe given by path or by the name of a shipped one.

    Raises
    ------
    FileNotFoundError
        If there is neither; the message lists the shipped names.
    """
    return _found("recipe", name_or_path, shipped_recipes())


def _found(kind: str, name_or_path: str, shipped: dict[str, Path]) -> Path:
    path = Path(name_or_path)
    if path.is_file():
        return path
    name = name_or_path.removesuffix(".yaml")
    if name in shipped:
        return shipped[name]
    raise FileNotFoundError(
        f"no {kind} file {name_or_path!r}: give a path or one of the shipped {kind}s {', '.join(shipped)}"
    )

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
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = shipped_worlds()
    if name_or_path.removesuffix(".yaml") in shipped:
        return shipped[name_or_path.removesuffix(".yaml")]
    raise FileNotFoundError(
        f"no world file {name_or_path!r}: give a path or one of the shipped worlds {', '.join(shipped)}"
    )

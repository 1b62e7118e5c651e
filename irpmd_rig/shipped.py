"""Configuration files that ship with the package: worlds, rigs and recipes, by name or by path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# In a wheel the folder lies inside the package, in a checkout beside it.
_PACKAGE = Path(__file__).parent
CONFIGS = next(folder for folder in (_PACKAGE / "configs", _PACKAGE.parent / "configs") if folder.is_dir())


@dataclass(frozen=True, slots=True)
class _Kind:
    """Files of one kind; its folder has its name, in the plural."""

    name: str

    def shipped(self) -> dict[str, Path]:
        """Shipped files by name."""
        return {path.stem: path for path in sorted((CONFIGS / f"{self.name}s").glob("*.yaml"))}

    def file(self, name_or_path: str) -> Path:
        """File given by path or by the name of a shipped one.

        Raises
        ------
        FileNotFoundError
            If there is neither; the message lists the shipped names.
        """
        path = Path(name_or_path)
        if path.is_file():
            return path
        shipped = self.shipped()
        found = shipped.get(name_or_path.removesuffix(".yaml"))
        if found is None:
            raise FileNotFoundError(
                f"no {self.name} file {name_or_path!r}: give a path or one of the shipped {self.name}s "
                f"{', '.join(shipped)}"
            )
        return found


_WORLD, _RIG, _RECIPE = _Kind("world"), _Kind("rig"), _Kind("recipe")

shipped_worlds, world_file = _WORLD.shipped, _WORLD.file
shipped_rigs, rig_file = _RIG.shipped, _RIG.file
shipped_recipes, recipe_file = _RECIPE.shipped, _RECIPE.file

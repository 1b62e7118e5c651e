"""Programs of this project that are started as processes of their own: from here, whatever the working folder holds."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_HERE = str(Path(__file__).resolve().parent.parent)


def module_command(module: str, *arguments: str) -> list[str]:
    """Command line that runs a module; a file of that name in the working folder is not taken for it."""
    return [sys.executable, "-P", "-m", module, *arguments]


def module_environment() -> dict[str, str]:
    """Environment for `module_command`: its modules are those of this very copy of the project."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([_HERE, *filter(None, [os.getenv("PYTHONPATH")])])}

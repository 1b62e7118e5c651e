"""The command line: one group of commands a module, each of which loads what it works with when it is called."""

from irpmd_rig.cli.application import app
from irpmd_rig.cli.entry import main

__all__ = ["app", "main"]

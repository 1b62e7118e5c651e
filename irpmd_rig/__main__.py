"""``python -m irpmd_rig`` is the command line."""

from irpmd_rig.cli import main

main()

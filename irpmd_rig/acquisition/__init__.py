"""The rig and what is done with it: rig file, instruments, exposures, moves, runs."""

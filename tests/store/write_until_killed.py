"""Write frames into a run folder until this process is killed; say after each flush how many are promised."""

import sys
from itertools import count
from pathlib import Path

from runs_on_disk import entry, picture

from irpmd_rig.store import RunFolder

folder = RunFolder(Path(sys.argv[1]))
promised = []
sys.stdout.write("ready\n")
sys.stdout.flush()
for number in count(int(sys.argv[2])):
    promised.append(folder.write_frame(picture(number), entry(number)).path)
    if number % 3 == 0:
        folder.flush()
        for path in promised:
            sys.stdout.write(f"{number} {path}\n")
        sys.stdout.flush()
        promised.clear()

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


def test_a_disk_that_fills_up_ends_in_one_typed_error_and_all_earlier_frames_are_good(tmp_path: Path) -> None:
    """On a file system of 2 MB; without the right to mount one, in a name space of its own."""
    own = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--mount"]
    script = Path(__file__).with_name("fill_disk.py")
    done = subprocess.run([*own, sys.executable, str(script), str(tmp_path)], capture_output=True, text=True)
    if "unshare failed" in done.stderr or "cannot mount" in done.stderr:
        pytest.skip(f"no file system of one's own here: {done.stderr.strip()}")
    assert (done.returncode, done.stderr) == (0, "")
    outcome = json.loads(done.stdout)
    assert 10 < outcome["durable"] < 40
    assert "no room at" in outcome["full"]
    assert outcome["frames"] == outcome["durable"]
    assert outcome["wrong"] == []
    assert outcome["export"] == errno.ENOSPC
    assert outcome["state"] == "failed"
    assert outcome["index"] == ["failed"]
    assert list(tmp_path.iterdir()) == []

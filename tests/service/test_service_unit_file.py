"""The systemd unit."""

import shutil
import subprocess
from configparser import RawConfigParser
from pathlib import Path

import pytest

from irpmd_rig.shipped import CONFIGS

UNIT = CONFIGS / "systemd" / "irpmd-rig.service"


def unit() -> RawConfigParser:
    found = RawConfigParser(strict=False)
    found.optionxform = str  # type: ignore[assignment,method-assign]
    found.read(UNIT)
    return found


def test_the_watchdog_is_fed_and_the_rig_left_safe() -> None:
    service = unit()["Service"]
    assert service["Type"] == "notify"
    assert int(service["WatchdogSec"]) > 0
    assert " serve " in service["ExecStart"]
    assert service["ExecStopPost"] == service["ExecStart"].replace(" serve ", " safe ")
    assert service["Restart"] == "on-failure"
    assert service["NoNewPrivileges"] == service["ProtectHome"] == "yes"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_it(tmp_path: Path) -> None:
    # Where the program is not installed, something else that is there stands for it.
    text = UNIT.read_text().replace("/opt/irpmd-rig/bin/irpmd-rig", "/bin/true").replace("User=irpmd", "User=root")
    (tmp_path / UNIT.name).write_text(text)
    found = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / UNIT.name)], capture_output=True, text=True, timeout=60
    )
    about_it = [line for line in found.stderr.splitlines() if UNIT.name in line]
    assert about_it == []
    exposure = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=40", str(tmp_path / UNIT.name)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert exposure.returncode == 0, exposure.stdout[-2000:] + exposure.stderr

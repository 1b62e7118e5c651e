"""A report in a real browser: the surface is drawn, nothing is complained of, no request leaves the page."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from measured_run import result, write_measured_run

from irpmd_rig.report.run import write_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--virtual-time-budget=5000",
)  # fmt: skip

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: apt install chromium")


def test_a_browser_draws_the_surface_and_asks_for_nothing(tmp_path: Path):
    run = write_measured_run(tmp_path / "run", result())
    write_report(run)
    page, log = run.results.path("report.html").as_uri(), tmp_path / "net.json"
    command = [
        BROWSER,
        *FLAGS,
        f"--user-data-dir={tmp_path / 'profile'}",
        f"--log-net-log={log}",
        "--enable-logging=stderr",
    ]
    seen = subprocess.run([*command, "--dump-dom", page], capture_output=True, text=True, timeout=100, check=True)
    assert 'class="turnable live"' in seen.stdout
    assert re.search(r'<span class="low">-?\d', seen.stdout)  # the legend, once the surface is there
    complaints = [line for line in seen.stderr.splitlines() if "CONSOLE" in line]
    assert complaints == []
    assert requests_of_pages(json.loads(log.read_text())) == set()


def requests_of_pages(log: dict) -> set[str]:
    """Addresses in a network log that a page asked for; what the browser itself asks for has no origin."""
    found = set()
    for event in log["events"]:
        asked = event.get("params", {})
        if asked.get("initiator", "not an origin") != "not an origin":
            found.add(asked["url"])
    return found

"""The campaigns in the size that fits among tests; in their full sizes they are commands."""

import json

import pytest

from tests.campaigns import faults, kills, replies
from tests.campaigns.report import Report


@pytest.mark.timeout(1200)
def test_twenty_runs_with_a_fault_at_a_random_moment() -> None:
    report = faults.campaign(20, 1)
    assert not report.bad, report
    assert report.figures["faults"] >= 20


@pytest.mark.timeout(1200)
def test_five_kills_in_the_middle_of_a_measurement() -> None:
    report = kills.campaign(5, 1)
    assert not report.bad, report


def test_a_thousand_generated_replies() -> None:
    report = replies.campaign(1000, 1)
    assert not report.bad, report


def test_a_report_is_one_line_and_an_exit_status(capsys: pytest.CaptureFixture[str]) -> None:
    report = Report("none", 1, 2)
    report.count("runs", 3)
    assert report.tell() == 0
    report.blame("hangs", "it hung", 2)
    assert report.tell() == 1
    good, bad = map(json.loads, capsys.readouterr().out.splitlines())
    assert (good["ok"], good["figures"]) == (True, {"runs": 3})
    assert (bad["ok"], bad["hangs"]) == (False, 2)

"""A test that is skipped proves nothing: in CI, where everything can be installed, it is a failure.

One group is left out, and said to be, where the machine does not allow it: what needs to mount a file system.
"""

import os
import signal

import pytest

from tests.own_file_system import why_not

# As in the program itself (`irpmd_rig`), and before any test module loads numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts what runs in the background deaf to Ctrl-C; the programs under test would inherit it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

MOUNTS = "mounts: needs to mount a file system of its own; left out where the machine does not allow that"
_left_out = pytest.StashKey[int]()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", MOUNTS)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    mounting = [item for item in items if item.get_closest_marker("mounts")]
    if mounting and why_not():
        items[:] = [item for item in items if item not in mounting]
        config.hook.pytest_deselected(items=mounting)
        config.stash[_left_out] = len(mounting)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if left_out := config.stash.get(_left_out, 0):
        terminalreporter.write_line(f"left out: {left_out} of the group `mounts`: {why_not()}", yellow=True)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    if os.environ.get("CI") == "true" and skipped and exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line(f"{len(skipped)} skipped: in CI a skipped test is a failure", red=True)

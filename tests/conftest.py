"""A test that is skipped proves nothing: in CI, where everything can be installed, it is a failure."""

import os

import pytest

# As in the program itself (`irpmd_rig`), and before any test module loads numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    if os.environ.get("CI") == "true" and skipped and exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line(f"{len(skipped)} skipped: in CI a skipped test is a failure", red=True)

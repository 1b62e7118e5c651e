"""What the command line tells of runs, and of which daemon it asks."""

from pathlib import Path

import pytest

from irpmd_rig.cli.connection import connect
from irpmd_rig.cli.telling import listing
from irpmd_rig.service.models import Run

RIG = "service: {{port: 4711}}\nstorage: {{root: {root}}}\n"


def run(**more: object) -> Run:
    values = {"id": "20260101-000000-abcdef", "kind": "measure", "name": "n", "state": "failed"}
    return Run.model_construct(None, **{"attempt": 1, "reason": None, **values, **more})


def test_each_run_has_a_line_whatever_its_name_is(capsys: pytest.CaptureFixture[str]) -> None:
    name = "a step of the second sample, turned by ninety degrees, with the precise recipe"
    listing([run(name=name, reason="frame_quality", detail="..."), run(state="succeeded")])
    head, first, second = capsys.readouterr().out.splitlines()
    assert head.split() == ["run", "kind", "name", "state", "reason", "attempt"]
    assert name in first
    assert first.split()[-3:] == ["failed", "frame_quality", "1"]
    assert "succeeded" in second


def test_options_go_before_the_environment_and_that_before_the_defaults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = Path("configs/rigs/sim.yaml").resolve()
    rig = tmp_path / "rig.yaml"
    text = shipped.read_text(encoding="utf-8").replace("../worlds", str(shipped.parents[1] / "worlds"))
    rig.write_text(text + RIG.format(root=tmp_path), encoding="utf-8")
    (tmp_path / "token").write_text("of the rig", encoding="ascii")
    (tmp_path / "other").write_text("of the environment", encoding="ascii")
    monkeypatch.setenv("IRPMD_RIG_URL", "http://127.0.0.1:1")
    monkeypatch.setenv("IRPMD_RIG_TOKEN", str(tmp_path / "other"))

    def asked(*options: str | Path | None) -> tuple[str, str]:
        with connect(*options) as client:  # type: ignore[arg-type]
            return client.url, client._http.headers["Authorization"]

    assert asked(None, None, None) == ("http://127.0.0.1:1/api/v1", "Bearer of the environment")
    assert asked(None, None, str(rig)) == ("http://127.0.0.1:4711/api/v1", "Bearer of the rig")
    assert asked("http://127.0.0.1:2", None, str(rig)) == ("http://127.0.0.1:2/api/v1", "Bearer of the rig")

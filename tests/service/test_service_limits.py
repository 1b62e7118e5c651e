"""What the service does when there is too much of something, or something it never met."""

import asyncio
import threading
from typing import Never

import httpx
import pytest
from service_world import API, RECIPE, Service, slug

from irpmd_rig.service.desk import Pool
from irpmd_rig.service.problems import ProblemError


def test_a_full_disk_is_told_before_a_run_is_made(
    service: Service, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = client.get(f"{API}/runs").json()
    monkeypatch.setattr(service.daemon.store, "free_bytes", lambda: 1000)
    answer = client.post(f"{API}/runs", json={"text": RECIPE})
    assert answer.status_code == 507
    assert slug(answer) == "disk-full"
    assert "delete or move old runs" in answer.json()["detail"]
    assert any("no room" in reason for reason in client.get(f"{API}/rig").json()["reasons"])
    checked = client.post(f"{API}/recipes/validate", json={"text": RECIPE}).json()
    assert (checked["ok"], len(checked["warnings"])) == (True, 1)
    assert client.get(f"{API}/runs").json() == before


def test_a_fault_of_the_program_is_a_problem_without_its_insides(
    service: Service, client: httpx.Client, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fault() -> Never:
        raise RuntimeError("of this test")

    monkeypatch.setattr(service.daemon, "queue_status", fault)
    answer = client.get(f"{API}/queue")
    assert answer.status_code == 500
    assert slug(answer) == "fault"
    assert "of this test" not in answer.text
    monkeypatch.undo()
    assert client.get(f"{API}/queue").status_code == 200
    assert "RuntimeError: of this test" in caplog.text


def test_calls_that_are_too_many_are_refused() -> None:
    async def crowd() -> tuple[list[str], int]:
        pool, go = Pool(1, waiting=2), threading.Event()

        def call() -> str:
            go.wait(60)
            return "done"

        tasks = [asyncio.create_task(pool(call)) for _ in range(5)]
        await asyncio.sleep(0.05)
        go.set()
        found = await asyncio.gather(*tasks, return_exceptions=True)
        refused = [error for error in found if isinstance(error, ProblemError)]
        assert all(error.problem.slug == "too-busy" for error in refused)
        assert all(error.problem.headers["Retry-After"] for error in refused)
        return [text for text in found if isinstance(text, str)], len(refused)

    assert asyncio.run(crowd()) == (["done"] * 3, 2)

"""Recipes in, runs and their files out."""

import base64
import hashlib
import io
import re
import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import h5py
import httpx
import numpy as np
import pytest
import tifffile
from service_world import API, ASKING, RECIPE, Service, lease, slug

from irpmd_rig.report.policy import VIEWER
from tests.small_world import until

RUNS = f"{API}/runs"
ID = re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}")


@pytest.fixture(scope="module")
def done(running: Service) -> Iterator[str]:
    """A run that has succeeded."""
    with running.client() as client:
        run_id: str = client.post(RUNS, json={"text": RECIPE}).json()["id"]
        assert client.post(f"{API}/queue/actions", json={"action": "resume"}).status_code == 200
        until(lambda: client.get(f"{RUNS}/{run_id}").json()["state"] in ("succeeded", "failed"))
        assert client.get(f"{RUNS}/{run_id}").json()["state"] == "succeeded"
    return run_id


def state_of(client: httpx.Client, run_id: str) -> str:
    state: str = client.get(f"{RUNS}/{run_id}").json()["state"]
    return state


def test_a_recipe_becomes_a_run(client: httpx.Client) -> None:
    answer = client.post(RUNS, json={"text": RECIPE})
    assert answer.status_code == 201
    run = answer.json()
    assert ID.fullmatch(run["id"])
    assert answer.headers["location"] == f"{RUNS}/{run['id']}"
    assert (run["state"], run["kind"], run["name"], run["attempt"]) == ("queued", "sequence", "two stations", 1)
    assert run["estimate"]["frames"] > 0
    assert client.get(answer.headers["location"]).json()["id"] == run["id"]
    assert client.get(RUNS).json()[0]["id"] == run["id"]
    assert run["id"] in client.get(f"{API}/queue").json()["waiting"]
    assert slug(client.delete(answer.headers["location"])) == "run-in-use"


def test_a_key_makes_one_run(client: httpx.Client) -> None:
    key = {"Idempotency-Key": "once and no more"}
    first = client.post(RUNS, json={"text": RECIPE}, headers=key)
    again = client.post(RUNS, json={"text": RECIPE}, headers=key)
    assert (first.status_code, again.status_code) == (201, 200)
    assert first.json()["id"] == again.json()["id"]
    assert first.headers["location"] == again.headers["location"]
    assert slug(client.post(RUNS, json={"text": ASKING}, headers=key)) == "key-reused"
    assert slug(client.post(RUNS, json={"text": RECIPE}, headers={"Idempotency-Key": "x" * 201})) == "invalid"


def test_everything_wrong_with_a_recipe_is_told_with_its_place(client: httpx.Client) -> None:
    text = RECIPE.replace("steps: 3}", "steps: 2}").replace("exposure_us", "exposure_uz")
    refused = client.post(RUNS, json={"text": text})
    assert slug(refused) == "recipe-refused"
    assert [(error["line"], error["column"]) for error in refused.json()["errors"]] == [(3, 1), (4, 34)]
    checked = client.post(f"{API}/recipes/validate", json={"text": text})
    assert checked.status_code == 200
    assert checked.json()["ok"] is False
    assert checked.json()["problems"] == refused.json()["errors"]
    beyond = RECIPE.replace("position_mm: 1.0", "position_mm: 5000.0")
    assert slug(client.post(RUNS, json={"text": beyond})) == "recipe-refused"


def test_shipped_recipes_go_by_their_id(client: httpx.Client) -> None:
    recipes = client.get(f"{API}/recipes").json()
    assert {"paper-measure", "calibrate-camera"} <= {recipe["id"] for recipe in recipes}
    for recipe in recipes:
        told = client.post(f"{API}/recipes/validate", json={"recipe": recipe["id"]}).json()
        assert told["kind"] == recipe["kind"]
        assert told["estimate"]["seconds"] > 0
    for name in ("nix", "../rigs/sim", "/etc/passwd", ""):
        assert slug(client.post(RUNS, json={"recipe": name})) == "no-such-recipe"
    assert slug(client.post(RUNS, json={"recipe": "paper-measure", "text": RECIPE})) == "invalid"


def test_a_hostile_recipe_keeps_nobody_waiting(service: Service, client: httpx.Client) -> None:
    hostile = "steps:\n" + "  - {do: move, stage: stage1, position_mm: 0.0}\n" * 2000
    answers: list[httpx.Response] = []
    with service.client() as other:
        thread = threading.Thread(target=lambda: answers.append(other.post(RUNS, json={"text": hostile})))
        posted_s = time.perf_counter()
        thread.start()
        waits_s = []
        while thread.is_alive():
            began_s = time.perf_counter()
            assert client.get(f"{API}/rig").status_code == 200
            waits_s.append(time.perf_counter() - began_s)
        thread.join()
        reading_s = time.perf_counter() - posted_s
    assert slug(answers[0]) == "recipe-refused"
    assert statistics.median(waits_s) < reading_s / 5


@pytest.mark.parametrize(
    "run_id", ["20260101-000000-abcdef", "nix", "%2e%2e", ".new-x", "%00", "index.sqlite", "x" * 500]
)
def test_other_ids_are_no_runs(client: httpx.Client, run_id: str) -> None:
    for path in ("", "/frames", "/results", "/events", "/frames/x.tif", "/results/x", "/exports/hdf5"):
        answer = client.get(f"{RUNS}/{run_id}{path}")
        assert slug(answer) in ("no-such-run", "not-found"), answer.text


def test_a_run_tells_of_itself(client: httpx.Client, done: str) -> None:
    run = client.get(f"{RUNS}/{done}").json()
    assert run["frames"] == len(client.get(f"{RUNS}/{done}/frames").json()) == 2
    assert run["reason"] is None
    older = client.get(RUNS, params={"before": done}).json()
    assert done not in [found["id"] for found in older]
    assert len(client.get(RUNS, params={"limit": 1}).json()) == 1
    assert slug(client.get(RUNS, params={"limit": 0})) == "invalid"


def test_frames_come_as_they_are_on_disk_and_otherwise(client: httpx.Client, done: str, running: Service) -> None:
    entry = client.get(f"{RUNS}/{done}/frames").json()[0]
    assert entry["path"].startswith("frames/")
    on_disk = (running.daemon.store.root / done / entry["path"]).read_bytes()
    answer = client.get(f"{RUNS}/{done}/{entry['path']}")
    assert answer.content == on_disk
    assert answer.headers["content-type"] == "image/tiff"
    image = tifffile.imread(io.BytesIO(on_disk))
    as_array = client.get(f"{RUNS}/{done}/{entry['path']}", params={"format": "npy"}).content
    np.testing.assert_array_equal(np.load(io.BytesIO(as_array)), image)
    as_png = client.get(f"{RUNS}/{done}/{entry['path']}", params={"format": "png"}).content
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(as_png, np.uint8), cv2.IMREAD_UNCHANGED), image)


OUTSIDE = ("../run.yaml", "..%2frun.yaml", "%2e%2e/run.yaml", "%2e%2e%2frun.yaml", "/etc/passwd", "%2fetc%2fpasswd")


@pytest.mark.parametrize("path", [*OUTSIDE, "x\u0000", "x" * 5000, "link.tif", ""])
def test_no_path_leaves_the_frames(client: httpx.Client, done: str, running: Service, path: str) -> None:
    link = running.daemon.store.root / done / "frames" / "link.tif"
    if not link.is_symlink():
        link.symlink_to("/etc/passwd")
    for folder in ("frames", "results"):
        answer = client.get(f"{RUNS}/{done}/{folder}/{path.encode().decode('latin-1')}".replace("\0", "%00"))
        assert answer.status_code == 404, answer.text
        assert "root:" not in answer.text


def test_results_come_as_files(client: httpx.Client, done: str, running: Service) -> None:
    folder = running.daemon.store.root / done / "results"
    folder.mkdir(exist_ok=True)
    (folder / "report.html").write_text("<script>alert(1)</script>")
    (folder / "steps.csv").write_text("step\n1\n")
    (folder / "steps.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    listed = {file["name"]: file for file in client.get(f"{RUNS}/{done}/results").json()}
    assert listed["steps.csv"] == {"name": "steps.csv", "bytes": 7, "media_type": "text/csv"}
    table = client.get(f"{RUNS}/{done}/results/steps.csv")
    assert table.text == "step\n1\n"
    assert "steps.csv" in table.headers["content-disposition"]
    report = client.get(f"{RUNS}/{done}/results/report.html")
    # Whatever a report holds, a browser runs none of it but the one script of ours, and loads nothing.
    policy = dict(part.strip().split(" ", 1) for part in report.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["sandbox"] == "allow-scripts"
    assert policy["script-src"] == f"'sha256-{base64.b64encode(hashlib.sha256(VIEWER.encode()).digest()).decode()}'"
    assert report.headers["content-disposition"].startswith("inline")
    drawing = client.get(f"{RUNS}/{done}/results/steps.svg")
    assert drawing.headers["content-type"].startswith("image/svg+xml")
    assert "script" not in drawing.headers["content-security-policy"]
    assert client.get(f"{RUNS}/{done}/exports/csv").text == "step\n1\n"
    assert slug(client.get(f"{RUNS}/{done}/exports/ply")) == "nothing-to-export"
    assert slug(client.get(f"{RUNS}/{done}/exports/zip")) == "invalid"


def test_a_run_is_exported_as_nexus(client: httpx.Client, done: str, running: Service, tmp_path: Path) -> None:
    answer = client.get(f"{RUNS}/{done}/exports/hdf5")
    assert answer.headers["content-type"] == "application/x-hdf5"
    (tmp_path / "run.h5").write_bytes(answer.content)
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["entry/frames/data"].shape == (2, 96, 96)
    until(lambda: not list(running.daemon.store.root.glob(".new-*")))


def test_what_cannot_be_a_calibration_is_not_activated(client: httpx.Client, done: str) -> None:
    assert client.get(f"{API}/calibrations").json() == client.get(f"{API}/references").json() == []
    assert slug(client.post(f"{API}/calibrations/{done}/activate")) == "not-usable"
    assert slug(client.post(f"{API}/references/nix/activate")) == "no-such-run"


def test_a_recipe_that_names_what_cannot_serve_is_refused_at_once(client: httpx.Client, done: str) -> None:
    for named in ("20260101-000000-abcdef", done):
        text = f"kind: measure\nname: x\nobject: mirror_step_y\nreference: {named}\n"
        answer = client.post(RUNS, json={"text": text})
        assert (answer.status_code, slug(answer)) == (422, "recipe-refused")
        (error,) = answer.json()["errors"]
        assert (error["line"], error["column"]) == (4, 12)
        assert named in error["what"]


def test_a_prompt_is_answered(client: httpx.Client) -> None:
    run_id = client.post(RUNS, json={"text": ASKING}).json()["id"]
    client.post(f"{API}/queue/actions", json={"action": "resume"})
    until(lambda: state_of(client, run_id) == "waiting_for_operator")
    assert client.get(f"{RUNS}/{run_id}").json()["prompt"]["text"] == "Look at it."
    held = lease(client)
    refused = client.post(f"{API}/devices/stage1/move", json={"position_mm": 0.0}, headers=held)
    assert slug(refused) == "rig-busy"
    assert refused.json()["run_id"] == run_id
    answered = client.post(f"{RUNS}/{run_id}/actions", json={"action": "answer"}, headers=held)
    assert answered.status_code == 200
    until(lambda: state_of(client, run_id) == "succeeded")
    assert slug(client.post(f"{RUNS}/{run_id}/actions", json={"action": "retry"}, headers=held)) == "action-refused"
    assert client.delete(f"{RUNS}/{run_id}").status_code == 204
    assert slug(client.get(f"{RUNS}/{run_id}")) == "no-such-run"


def test_a_run_is_aborted_and_retried(client: httpx.Client) -> None:
    run_id = client.post(RUNS, json={"text": ASKING}).json()["id"]
    client.post(f"{API}/queue/actions", json={"action": "resume"})
    until(lambda: state_of(client, run_id) == "waiting_for_operator")
    held = lease(client)
    aborted = client.post(f"{RUNS}/{run_id}/actions", json={"action": "abort"}, headers=held).json()
    assert (aborted["state"], aborted["reason"]) == ("aborted", "aborted_by_user")
    assert client.get(f"{API}/queue").json()["held"] is True
    retried = client.post(f"{RUNS}/{run_id}/actions", json={"action": "retry"}, headers=held).json()
    assert (retried["state"], retried["attempt"]) == ("queued", 2)

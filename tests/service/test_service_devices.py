"""Instruments by hand."""

import io

import cv2
import httpx
import numpy as np
import pytest
import tifffile
from service_world import API, Service, lease, slug

from irpmd_rig.acquisition.control import WorldControl
from tests.small_world import until

DEVICES = f"{API}/devices"


@pytest.fixture
def held(client: httpx.Client) -> dict[str, str]:
    return lease(client)


def test_a_frame_is_the_same_in_every_format(client: httpx.Client, held: dict[str, str]) -> None:
    set_to = {"exposure_us": 3000.0, "pixel_format": "Mono10"}
    in_force = client.post(f"{DEVICES}/camera/settings", json=set_to, headers=held).json()
    assert in_force["exposure_us"] == pytest.approx(3000.0, rel=0.01)
    assert in_force["pixel_format"] == "Mono10"
    client.post(f"{DEVICES}/projector/show", json={"picture": "white"}, headers=held)
    client.post(f"{DEVICES}/projector/led", json={"led": "infrared", "intensity": 0.5}, headers=held)
    frames = {}
    for form in ("tiff", "png", "npy"):
        answer = client.post(f"{DEVICES}/camera/frame", params={"format": form}, headers=held)
        assert answer.status_code == 200, answer.text
        assert answer.headers["x-bits"] == "10"
        frames[form] = answer.content
    read = (
        tifffile.imread(io.BytesIO(frames["tiff"])),
        cv2.imdecode(np.frombuffer(frames["png"], np.uint8), cv2.IMREAD_UNCHANGED),
        np.load(io.BytesIO(frames["npy"])),
    )
    for image in read:
        assert image is not None
        assert image.dtype == np.uint16
        assert image.shape == (96, 96)
        # Three exposures of the same light.
        assert image.mean() == pytest.approx(read[0].mean(), rel=0.02)
    assert slug(client.post(f"{DEVICES}/camera/frame?format=gif", headers=held)) == "invalid"


def test_settings_that_the_camera_has_not_are_refused(client: httpx.Client, held: dict[str, str]) -> None:
    answer = client.post(f"{DEVICES}/camera/settings", json={"pixel_format": "Mono12"}, headers=held)
    assert slug(answer) in ("unsupported", "instrument-refused")
    assert answer.json()["device"] == "camera"


def test_the_projector_does_as_it_is_told(client: httpx.Client, held: dict[str, str], lab: WorldControl) -> None:
    fringes = {"picture": "fringes", "count": 8, "step": 1, "steps": 4, "axis": "y"}
    assert client.post(f"{DEVICES}/projector/show", json=fringes, headers=held).status_code == 204
    lit = {"led": "infrared", "intensity": 0.25}
    assert client.post(f"{DEVICES}/projector/led", json=lit, headers=held).status_code == 204
    state = lab.call("state")
    assert state["led"] == "infrared"
    assert state["intensity"] == pytest.approx(0.25, abs=0.01)
    assert client.post(f"{DEVICES}/projector/park", json={"parked": True}, headers=held).status_code == 204
    assert lab.call("state")["parked"] is True
    assert client.post(f"{DEVICES}/projector/park", json={"parked": False}, headers=held).status_code == 204
    # Whoever gives the lease back leaves the rig dark.
    client.post(f"{DEVICES}/projector/led", json=lit, headers=held)
    client.delete(f"{API}/lease", headers=held)
    assert not lab.call("state")["intensity"]


@pytest.mark.parametrize(
    "body",
    [
        {"picture": "white", "step": 1.5},
        {"picture": "grey"},
        {"picture": "fringes", "step": 4, "steps": 4},
        {"picture": "fringes", "count": 0},
    ],
)
def test_pictures_that_cannot_be_are_refused(client: httpx.Client, held: dict[str, str], body: object) -> None:
    assert slug(client.post(f"{DEVICES}/projector/show", json=body, headers=held)) == "invalid"


def test_an_led_is_never_lit_above_its_limit(client: httpx.Client, held: dict[str, str], lab: WorldControl) -> None:
    too_bright = {"led": "infrared", "intensity": 0.61}
    assert slug(client.post(f"{DEVICES}/projector/led", json=too_bright, headers=held)) == "invalid"
    assert not lab.call("state")["intensity"]


def test_a_stage_moves_and_says_where_it_is(client: httpx.Client, held: dict[str, str], lab: WorldControl) -> None:
    answer = client.post(f"{DEVICES}/stage1/move", json={"position_mm": 2.5}, headers=held)
    assert answer.json() == {"position_mm": pytest.approx(2.5, abs=0.01), "measured": True}
    assert lab.call("state")["stages"]["stage1"]["position_mm"] == pytest.approx(2.5, abs=0.01)
    assert client.get(f"{API}/rig").json()["axes"]["stage1"]["position"]["position_mm"] == pytest.approx(2.5, abs=0.01)
    beyond = client.post(f"{DEVICES}/stage1/move", json={"position_mm": 5000.0}, headers=held)
    assert slug(beyond) == "limit"
    assert beyond.json()["device"] == "stage1"
    assert client.post(f"{DEVICES}/stage1/home", headers=held).status_code == 200
    zeroed = client.post(f"{DEVICES}/stage2/zero", json={"position_mm": 0.0, "confirmed_by": "Ada"}, headers=held)
    assert zeroed.status_code in (200, 409, 422)
    assert client.post(f"{DEVICES}/stage1/stop", headers=held).json()["outcome"] == "stopped"


@pytest.mark.parametrize("name", ["stage3", "camera", "projector", "..", "%00"])
def test_other_instruments_do_not_move(client: httpx.Client, held: dict[str, str], name: str) -> None:
    answer = client.post(f"{DEVICES}/{name}/move", json={"position_mm": 1.0}, headers=held)
    assert slug(answer) in ("no-such-device", "not-found", "method-not-allowed")


def test_a_live_view_shows_pictures(client: httpx.Client, held: dict[str, str]) -> None:
    answer = client.get(f"{DEVICES}/camera/live?limit=3", headers=held)
    assert answer.headers["content-type"] == "multipart/x-mixed-replace; boundary=irpmd-rig-frame"
    parts = answer.content.split(b"--irpmd-rig-frame\r\n")[1:]
    assert len(parts) == 3
    for part in parts:
        picture = cv2.imdecode(np.frombuffer(part.split(b"\r\n\r\n", 1)[1], np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert picture.shape == (96, 96)


def test_a_live_view_is_shared_and_ends_with_the_lease(service: Service, client: httpx.Client) -> None:
    held = lease(client)
    with (
        service.client() as second,
        client.stream("GET", f"{DEVICES}/camera/live", headers=held) as one,
        second.stream("GET", f"{DEVICES}/camera/live", headers=held) as two,
    ):
        ones, twos = one.iter_raw(), two.iter_raw()
        assert next(ones)
        assert next(twos)
        with service.client() as third:
            third.delete(f"{API}/lease", headers=held)
        # Both end by themselves.
        for _ in ones:
            pass
        for _ in twos:
            pass
    assert "irpmd_rig_streams 0.0" in client.get("/metrics").text


def test_nothing_is_taken_when_nobody_watches_any_more(service: Service, client: httpx.Client) -> None:
    held = lease(client)
    with service.client() as watcher, watcher.stream("GET", f"{DEVICES}/camera/live", headers=held) as live:
        next(live.iter_raw())
    until(lambda: "irpmd_rig_streams 0.0" in client.get("/metrics").text)


def test_no_first_picture_is_a_problem(client: httpx.Client, held: dict[str, str]) -> None:
    client.post(f"{API}/stop")
    assert slug(client.get(f"{DEVICES}/camera/live", headers=held)) == "stopped"

"""A rig file that is wrong: the service says where, and does not end."""

import time

import httpx

from tests.campaigns.lab import Lab


def test_a_broken_configuration_is_told_with_its_place_and_the_service_stays(lab: Lab) -> None:
    lab.write_rig("lihgt: {led: infrared}\n")
    line = lab.rig.read_text().splitlines().index("lihgt: {led: infrared}") + 1
    place = f"{lab.rig}:{line}:1"
    with (
        lab.serving(says="broken") as (process, url),
        httpx.Client(base_url=url, trust_env=False, timeout=60.0) as client,
    ):
        for path in ("/", "/health", "/api/v1/rig"):
            page = client.get(path, headers={"Accept": "text/html"})
            assert page.status_code == 503
            assert page.headers["content-type"].startswith("text/html")
            assert place in page.text
            problem = client.get(path)
            assert problem.headers["content-type"] == "application/problem+json"
            error = problem.json()["errors"][0]
            assert (error["file"], error["line"], error["column"]) == (str(lab.rig), line, 1)
            assert "light" in error["remedy"] or "light" in error["what"]
        assert client.post("/api/v1/runs", json={}).status_code == 503
        assert client.get("/", headers={"Host": "rig.example.org"}).status_code == 403
        time.sleep(0.5)
        assert process.poll() is None
        assert lab.log.read_text().count(place) == 1
        process.terminate()
        assert process.wait(60) == 0
    assert not lab.root.exists()
    lab.write_rig()
    with lab.daemon() as daemon:
        daemon.ready()
        lab.at_rest()

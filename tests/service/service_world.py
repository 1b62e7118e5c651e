"""A service on a small simulated rig, answering on a free port."""

import asyncio
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.service import ServiceSettings, create_app
from irpmd_rig.service.notify import Notifier
from irpmd_rig.service.server import Server, listen
from tests.small_world import until

TOKEN = "0123456789abcdef0123456789abcdef"
API = "/api/v1"

RECIPE = """kind: sequence
name: two stations
exposure_us: 2000.0
fringes: {counts: [8, 7], steps: 3}
steps:
  - {do: prompt, text: Place the mirror., subject: mirror}
  - {do: show, pattern: white}
  - {do: move, stage: stage1, position_mm: 0.0}
  - {do: capture, label: mirror}
  - {do: move, stage: stage1, position_mm: 1.0}
  - {do: capture, label: mirror}
"""
# Asks what no simulated operator answers.
ASKING = RECIPE.replace("text: Place the mirror., subject: mirror", "text: Look at it.")


def rig_file_text(world_folder: Path, root: Path) -> str:
    """The same as a file, for a daemon in a process of its own."""
    shipped = Path("configs/rigs/sim.yaml").resolve()
    text = shipped.read_text().replace("../worlds", str(shipped.parent.parent / "worlds"))
    return f"{text}\nsimulation: {{folder: {world_folder}}}\nstorage: {{root: {root}, reserve_gb: 0.0}}\n"


class Service:
    """A running service, and clients of it."""

    def __init__(self, daemon: RigDaemon, url: str) -> None:
        self.daemon = daemon
        self.url = url

    def client(self, **settings: Any) -> httpx.Client:
        headers = {"Authorization": f"Bearer {TOKEN}"} | settings.pop("headers", {})
        # Without certificates, which take longer to load than all else.
        return httpx.Client(base_url=self.url, headers=headers, trust_env=False, timeout=60.0, verify=False, **settings)


@contextmanager
def serving(daemon: RigDaemon, **settings: Any) -> Iterator[Service]:
    """Serve a daemon from a thread."""
    app = create_app(daemon, ServiceSettings(TOKEN, **settings))
    with listen("127.0.0.1", 0) as line:
        server = Server(app, line, Notifier({}), app.state.desk.close)
        thread = threading.Thread(target=asyncio.run, args=(server.serve(),))
        thread.start()
        try:
            until(lambda: server.started)
            yield Service(daemon, server.url)
        finally:
            server.ask_to_end()
            thread.join(60)
            assert not thread.is_alive()


def slug(answer: httpx.Response) -> str:
    """Which problem an answer is."""
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    document = answer.json()
    assert document["status"] == answer.status_code
    assert document["instance"] == answer.request.url.path
    kind: str = document["type"]
    assert kind.startswith("/problems/")
    return kind.removeprefix("/problems/")


def lease(client: httpx.Client, owner: str = "Ada", **more: Any) -> dict[str, str]:
    """Take the lease; returns the header that commands carry."""
    answer = client.post(f"{API}/lease", json={"owner": owner} | more)
    assert answer.status_code == 201, answer.text
    return {"X-Lease": answer.json()["id"]}


def daemon_command(rig: Path) -> list[str]:
    """Command of a daemon in a process of its own, on a free port."""
    return [
        sys.executable,
        "-c",
        "import sys; from irpmd_rig.service import serve; serve(sys.argv[1], port=0)",
        str(rig),
    ]

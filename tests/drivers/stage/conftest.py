"""Peers and stages on them, closed and ended after each test."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from stage_peers import Answer, Gsc, Peer, silent

from drivers.registry import make
from drivers.stage.engine import SerialStage


@pytest.fixture
def peer_at(tmp_path: Path) -> Iterator[Callable[..., Peer]]:
    peers: list[Peer] = []

    def start(answer: Answer = silent, *, frame_bytes: int | None = None, by_socket: bool = False) -> Peer:
        link = None if by_socket else tmp_path / f"tty{len(peers)}"
        peers.append(Peer(answer, frame_bytes, link))
        return peers[-1]

    yield start
    for peer in peers:
        peer.end()


@pytest.fixture
def stage_on() -> Iterator[Callable[..., SerialStage]]:
    stages: list[SerialStage] = []

    def build(peer: Peer, dialect: str, *, name: str = "stage1", opened: bool = True, **settings: Any) -> SerialStage:
        values: dict[str, Any] = {
            "port": peer.url,
            "dialect": dialect,
            "counts_per_mm": 1000.0,
            "sign": 1,
            "limits_mm": (-50.0, 50.0),
            "speed_mm_per_s": 10.0,
            "settle_s": 0.0,
            "reconnect_s": 2.0,
            "moving_at_open_s": 0.0,
        }
        stage = make("stage", "serial", name, values | settings)
        assert isinstance(stage, SerialStage)
        stages.append(stage)
        if opened:
            stage.open()
        return stage

    yield build
    for stage in stages:
        stage.close()


@pytest.fixture
def gsc() -> Gsc:
    return Gsc()


@pytest.fixture
def quick(tmp_path: Path) -> Callable[..., str]:
    """A copy of a shipped dialect whose pauses are short; nothing else is changed."""

    def copy(name: str, pause_s: float = 0.05) -> str:
        source = Path(__file__).parents[3] / "drivers" / "stage" / "dialects" / f"{name}.yaml"
        target = tmp_path / f"{name}-quick.yaml"
        target.write_text(re.sub(r"pause_s: [0-9.]+", f"pause_s: {pause_s}", source.read_text()))
        return str(target)

    return copy

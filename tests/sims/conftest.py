"""Worlds for the tests of the optics: the shipped ones, seen by a smaller camera of the same field of view."""

from pathlib import Path

import pytest

from sims.world import World, load_world

WORLDS = Path(__file__).parents[2] / "configs" / "worlds"


@pytest.fixture(scope="session")
def worlds() -> Path:
    return WORLDS


@pytest.fixture(scope="session")
def ideal() -> World:
    return load_world(WORLDS / "ideal.yaml").with_camera_size(256)


@pytest.fixture(scope="session")
def aligned() -> World:
    return load_world(WORLDS / "aligned.yaml").with_camera_size(256)


@pytest.fixture(scope="session")
def misaligned() -> World:
    return load_world(WORLDS / "misaligned.yaml").with_camera_size(256)

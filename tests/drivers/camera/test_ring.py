"""The ring: who owns a slot, and that nothing is left."""

import gc
import os
from pathlib import Path

import numpy as np
import pytest

from drivers.camera.ring import RingReader, RingWriter

SHAPE, KIND = (4, 8), np.dtype(np.uint8)
NAME = "camera frames"


def mappings() -> int:
    return Path("/proc/self/maps").read_text().count(NAME)


def descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def put(writer: RingWriter, value: int) -> int:
    slot = writer.free_slot()
    assert slot is not None
    writer.array(slot, SHAPE, KIND)[:] = value
    writer.take(slot)
    return slot


@pytest.fixture
def ring():
    writer = RingWriter(4, 32)
    reader = RingReader(writer.descriptor, 4, 32)
    yield writer, reader
    writer.close()


def test_a_frame_is_read_only_and_frees_its_slot_when_the_last_view_of_it_is_gone(ring):
    writer, reader = ring
    image = reader.take(put(writer, 7), SHAPE, KIND)
    assert (image == 7).all()
    with pytest.raises(ValueError, match="read-only"):
        image[0, 0] = 1
    view = image[1:3][:, ::2].T
    assert writer.free_slot() == 1
    del image
    gc.collect()
    assert writer.free_slot() == 1
    assert (view == 7).all()
    del view
    gc.collect()
    assert writer.free_slot() == 0


def test_a_caller_who_keeps_frames_starves_nobody(ring):
    writer, reader = ring
    kept = [reader.take(put(writer, value), SHAPE, KIND) for value in range(20)]
    assert [int(image[0, 0]) for image in kept] == list(range(20))
    assert writer.free_slot() is not None


def test_nothing_is_taken_while_all_slots_are_full(ring):
    writer, reader = ring
    for value in range(4):
        put(writer, value)
    assert writer.free_slot() is None
    reader.free(2)
    assert writer.free_slot() == 2


def test_frames_outlive_the_ring_and_take_it_with_them():
    before = mappings(), descriptors()
    writer = RingWriter(4, 32)
    reader = RingReader(writer.descriptor, 4, 32)
    image = reader.take(put(writer, 9), SHAPE, KIND)
    writer.close()
    del reader
    assert (image == 9).all()
    assert descriptors() == before[1]
    del image
    gc.collect()
    assert (mappings(), descriptors()) == before


@pytest.mark.parametrize(("slot", "shape"), [(-1, SHAPE), (4, SHAPE), (0, (4, 9)), (0, (0, 8)), (0, (-4, 8))])
def test_what_lies_outside_is_refused(ring, slot, shape):
    with pytest.raises(ValueError, match="outside the ring"):
        ring[1].take(slot, shape, KIND)


@pytest.mark.parametrize(("slots", "slot_bytes"), [(400, 32), (4, 1 << 20), (0, 32), (4, 0)])
def test_a_ring_that_is_smaller_than_announced_is_refused(ring, slots, slot_bytes):
    with pytest.raises(ValueError, match="smaller"):
        RingReader(ring[0].descriptor, slots, slot_bytes)


def test_memory_cannot_shrink_under_the_reader(ring):
    with pytest.raises(PermissionError):
        os.ftruncate(ring[0].descriptor, 10)

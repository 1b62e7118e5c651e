"""Messages over the socket pair: whole, in pieces, and what is none."""

import contextlib
import os
import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.channel import MESSAGE_LIMIT_BYTES, Channel, ChannelError, Messages
from drivers.camera.messages import capabilities_from, dump_from, error_from, settings_from, settings_message
from drivers.errors import ConfigurationError, InstrumentError
from drivers.values import CameraSettings, Region


def test_messages_and_descriptors_pass():
    ours, theirs = (Channel(end) for end in socket.socketpair())
    with Path(os.devnull).open("rb") as file:
        theirs.send({"reply": 1}, file.fileno())
    theirs.send({"lost": 2})
    received = ours.receive()
    while len(received) < 2:
        received += ours.receive()
    assert received == [{"reply": 1}, {"lost": 2}]
    os.close(ours.descriptors.popleft())
    theirs.shut_down()
    with pytest.raises(EOFError):
        ours.receive()
    ours.close()
    theirs.close()


def test_a_sender_never_waits_for_one_who_does_not_read():
    ours, theirs = (Channel(end) for end in socket.socketpair())

    def send_for_ever():
        while True:
            ours.send({"do": "x" * 1000}, wait=False)

    with pytest.raises(BlockingIOError):
        send_for_ever()
    ours.close()
    theirs.close()


@given(pieces=st.lists(st.binary(max_size=60), max_size=10))
def test_any_bytes_are_messages_or_a_typed_error(pieces):
    messages = Messages()
    try:
        for piece in pieces:
            for message in messages.feed(piece):
                assert isinstance(message, dict)
    except ChannelError:
        pass


@given(body=st.binary(max_size=60))
def test_any_body_is_a_message_or_a_typed_error(body):
    try:
        (message,) = Messages().feed(len(body).to_bytes(4, "big") + body)
        assert isinstance(message, dict)
    except ChannelError:
        pass


def test_an_endless_message_is_refused():
    with pytest.raises(ChannelError):
        Messages().feed((MESSAGE_LIMIT_BYTES + 1).to_bytes(4, "big"))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["kind", "what", "remedy", "location", "region", "trigger", "xml", "nodes", "vendor"]),
            inner,
        )
    ),
    max_leaves=8,
)


@given(answer=JSON)
def test_any_answer_is_understood_or_a_typed_error(answer):
    for parse in (settings_from, capabilities_from, dump_from, lambda told: error_from("camera", told)):
        with contextlib.suppress(ChannelError):
            parse(answer)


def test_settings_survive_the_way():
    settings = CameraSettings(exposure_us=1.5, region=Region(1, 2, 3, 4), trigger="hardware")
    assert settings_from(settings_message(settings)) == settings


def test_errors_survive_the_way():
    told = {"kind": "ConfigurationError", "what": "a", "remedy": "b", "location": ["producer"]}
    error = error_from("camera", told)
    assert isinstance(error, ConfigurationError)
    assert (error.device, error.what, error.remedy, error.location) == ("camera", "a", "b", ("producer",))
    assert isinstance(error_from("camera", {**told, "kind": "DeviceLost", "location": []}), InstrumentError)

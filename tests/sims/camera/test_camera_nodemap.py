"""The node map: what GenICam's own parser makes of it, and that registers hold what they are given."""

from itertools import pairwise

import pytest
from genicam.genapi import NodeMap as GenApiNodeMap
from hypothesis import given
from hypothesis import strategies as st

from sims.camera.features import features
from sims.camera.nodemap import XML_ADDRESS, NodeMap, Register
from sims.camera.wire import Refusal, Status

FEATURES = features(float_exposure=True)


@pytest.mark.parametrize(("float_exposure", "interface"), [(True, "IFloat"), (False, "IInteger")])
def test_genicams_parser_finds_every_feature(float_exposure: bool, interface: str) -> None:
    offered = features(float_exposure=float_exposure)
    parsed = GenApiNodeMap()
    parsed.load_xml_from_string(NodeMap(offered, "MQ042RG-CM").xml.decode())
    assert [feature.name for feature in offered if not parsed.has_node(feature.name)] == []
    assert type(parsed.get_node("ExposureTime")).__name__ == interface


def test_no_register_overlaps_another_or_the_xml() -> None:
    node_map = NodeMap(FEATURES, "MQ042RG-CM")
    spans = sorted((address, register.size) for address, register in node_map.registers.items())
    for (address, size), (following, _) in pairwise(spans):
        assert address + size <= following
    assert spans[-1][0] + spans[-1][1] <= XML_ADDRESS


@given(address=st.integers(0, 2**64 - 1), size=st.integers(0, 10_000))
def test_any_other_address_is_refused(address: int, size: int) -> None:
    node_map = NodeMap(FEATURES, "MQ042RG-CM")
    known = node_map.registers.get(address)
    if known is not None and known.size == size:
        assert node_map.register(address, size) is known
        return
    with pytest.raises(Refusal) as refusal:
        node_map.register(address, size)
    assert refusal.value.status is Status.INVALID_ADDRESS


@given(st.integers(-(2**63), 2**63 - 1))
def test_integers_survive(value: int) -> None:
    register = Register(next(feature for feature in FEATURES if feature.name == "Width"), "value")
    assert register.decode(register.encode(value)) == value


@given(st.floats(allow_nan=False))
def test_floats_survive(value: float) -> None:
    register = Register(next(feature for feature in FEATURES if feature.name == "Gain"), "value")
    assert register.decode(register.encode(value)) == value

"""One operation at a time, and none that escapes a stop."""

import pytest

from drivers.errors import Refused
from drivers.projector.gate import Gate


def test_an_operation_that_was_stopped_ends_at_its_next_step():
    gate = Gate("projector")
    with gate.operation():
        gate.check()
        with gate.stopping():
            pass
        with pytest.raises(Refused, match="was stopped"):
            gate.check()
        with pytest.raises(Refused, match="was stopped"):
            gate.pause(1.0)
    with gate.operation():
        gate.check()


def test_nothing_begins_while_it_is_stopped():
    gate = Gate("projector")
    with gate.stopping(), gate.stopping(), pytest.raises(Refused, match="being stopped"), gate.operation():
        pass
    with gate.operation(), pytest.raises(Refused, match="another operation"), gate.operation():
        pass

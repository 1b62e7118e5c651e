"""Room that has to stay free on the disk: a run that would take it is refused, and made when there is some again."""

import pytest

from irpmd_rig.client import ProblemError
from tests.campaigns.lab import Lab
from tests.campaigns.recipes import stations

RECIPE = stations(0, pattern="white")


def test_the_reserve_is_kept_and_the_refused_run_leaves_nothing(lab: Lab) -> None:
    lab.write_rig(reserve_gb=1e6)
    with lab.daemon() as daemon:
        before = sorted(lab.root.iterdir())
        with pytest.raises(ProblemError) as caught:
            daemon.submit(RECIPE)
        assert caught.value.status == 507
        assert "no room" in caught.value.detail
        assert sorted(lab.root.iterdir()) == before
        assert daemon.client.queue().waiting == ()
        assert any("no room" in reason for reason in daemon.client.rig().reasons)
        lab.at_rest()
    lab.write_rig()
    with lab.daemon() as daemon:
        assert daemon.carry_out(RECIPE).state == "succeeded"

"""The small size of the campaign of generated requests."""

from tests.campaigns.generated_requests import Campaign, small_service

SIZE = 300


def test_generated_requests_are_answered_as_described() -> None:
    with small_service() as service:
        campaign = Campaign(service, seed=20261122)
        campaign.run(SIZE)
        assert campaign.failures == []
        assert campaign.sent >= SIZE
        assert service.daemon.rig_status().time_s > 0
    names = {name for name, _ in campaign.statuses}
    assert {"stop", "clear_stop", "submit", "act", "stage_move", "camera_frame", "export"} <= names
    # Not only refusals.
    assert sum(count for (_, status), count in campaign.statuses.items() if status < 300) > SIZE / 5

"""The acquisition cycle at a small size: at the instruments' true pace, and with every frame on disk."""

from irpmd_rig.bench.acquire import run


def test_a_cycle_takes_what_physics_asks_for_and_little_more(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cycle, durable = run(size_px=128, cycles=1)
    # 40 mm at 20 mm/s with ramps of 0.2 s, and 0.2 s to settle; frames come on top.
    assert cycle.baseline_value > 2400.0
    assert 0.0 < cycle.ratio < 2000.0
    assert durable.value > cycle.value
    assert not list(tmp_path.iterdir())

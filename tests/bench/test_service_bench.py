from irpmd_rig.bench import service


def test_the_service_is_measured_beside_frames_and_computing() -> None:
    rows = {row.name: row for row in service.run(size_px=256, requests=60)}
    late = rows[f"{service.NAME}, 99th percentile"]
    assert late.unit == "ms"
    assert 0 < rows[f"{service.NAME}, median"].value <= late.value
    assert (late.must, late.aim) == (50.0, 20.0)
    assert rows[f"{service.NAME}: frames meanwhile"].value > 10
    assert rows[f"{service.NAME}: reconstructions meanwhile"].value >= 1

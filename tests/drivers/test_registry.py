"""Names of drivers in a rig file, those of third parties included."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import ConfigurationError
from drivers.protocols import Stage
from drivers.registry import Kind, driver_class, driver_names, make
from drivers.stage.engine import SerialStage

STAGE: dict[str, Any] = {
    "port": "/dev/ttyUSB0",
    "dialect": "gsc",
    "counts_per_mm": 1000.0,
    "sign": 1,
    "limits_mm": [0, 300],
    "speed_mm_per_s": 10,
}


@pytest.fixture
def third_party(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install a distribution with one entry point, as pip would lay it out."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def install(entry: str, code: str, module: str) -> None:
        (tmp_path / f"{module}.py").write_text(code)
        info = tmp_path / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[irpmd_rig.drivers]\n{entry}\n")
        monkeypatch.delitem(sys.modules, module, raising=False)

    return install


def test_the_drivers_of_this_package_are_known() -> None:
    assert {"harvesters", "aravis"} <= set(driver_names("camera"))
    assert {"video", "lightcommander", "dlpc350"} <= set(driver_names("projector"))
    assert "serial" in driver_names("stage")


@pytest.mark.parametrize(
    ("kind", "driver"),
    [(kind, name) for kind in ("camera", "projector", "stage") for name in driver_names(kind)],
)
def test_every_known_driver_loads(kind: Kind, driver: str) -> None:
    assert hasattr(driver_class(kind, driver, device="it"), "Settings")


def test_a_stage_is_made_from_a_rig_file_s_settings_without_touching_the_device() -> None:
    stage = make("stage", "serial", "stage1", STAGE)
    assert isinstance(stage, SerialStage)
    assert isinstance(stage, Stage)
    assert stage.name == "stage1"
    assert stage.limits().upper_mm == 300.0


def test_an_unknown_driver_names_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="no camera driver 'harvester'") as caught:
        make("camera", "harvester", "camera", {})
    assert "did you mean 'harvesters'?" in caught.value.remedy
    assert caught.value.location == ("driver",)


@pytest.mark.parametrize(
    ("change", "location", "remedy"),
    [
        ({"prot": "x"}, ("prot",), "did you mean 'port'?"),
        ({"line": {"baudrate": 9600}}, ("line", "baudrate"), "did you mean 'baud'?"),
        ({"speeds": {"kind": "table", "speed": []}}, ("speeds", "speed"), "did you mean 'speeds'?"),
        ({"limits_mm": [300, 0]}, ("limits_mm",), "correct limits_mm"),
        ({"limits_mm": [0, 300], "travel_mm": 200.0}, ("limits_mm",), "narrow limits_mm"),
        ({"counts_per_mm": 0}, ("counts_per_mm",), "correct counts_per_mm"),
        ({"counts_per_mm": float("nan")}, ("counts_per_mm",), "correct counts_per_mm"),
        ({"sign": 2}, ("sign",), "correct sign"),
        ({"axis": 10}, ("axis",), "at most 1"),
        ({"speed_mm_per_s": 21}, ("speed_mm_per_s",), "0.5 to 20 mm/s"),
        ({"dialect": "gsd"}, ("dialect",), "did you mean"),
    ],
)
def test_a_wrong_setting_is_found_before_anything_is_opened(
    change: dict[str, Any], location: tuple[str, ...], remedy: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make("stage", "serial", "stage1", STAGE | change)
    assert caught.value.device == "stage1"
    assert caught.value.location == location
    assert remedy in caught.value.remedy


def test_a_third_party_adds_a_driver_by_an_entry_point(third_party: Callable[..., None]) -> None:
    third_party(
        "stage.mystage = mystage:MyStage",
        "from drivers.stage.engine import SerialStage\nclass MyStage(SerialStage): pass\n",
        "mystage",
    )
    assert "mystage" in driver_names("stage")
    assert make("stage", "mystage", "stage1", STAGE).name == "stage1"


def test_a_third_party_s_driver_must_have_every_operation(third_party: Callable[..., None]) -> None:
    third_party(
        "stage.half = halfstage:Half",
        "from drivers.settings import Settings as Base\n"
        "class Half:\n    class Settings(Base): pass\n"
        "    def __init__(self, name, settings): self.name = name\n",
        "halfstage",
    )
    with pytest.raises(ConfigurationError, match=r"is no stage: it lacks .*move_to"):
        make("stage", "half", "stage1", {})


def test_a_driver_that_cannot_be_imported_says_what_to_install(third_party: Callable[..., None]) -> None:
    third_party("camera.needy = needycamera:Needy", "import not_installed_anywhere\n", "needycamera")
    with pytest.raises(ConfigurationError) as caught:
        make("camera", "needy", "camera", {})
    assert "not_installed_anywhere" in caught.value.remedy


def test_an_entry_point_that_is_no_class_is_refused(third_party: Callable[..., None]) -> None:
    third_party("camera.odd = oddcamera:THING", "THING = 5\n", "oddcamera")
    with pytest.raises(ConfigurationError, match="no driver class"):
        make("camera", "odd", "camera", {})


def test_nobody_takes_the_name_of_another_driver(third_party: Callable[..., None]) -> None:
    third_party("stage.serial = thief:Thief", "class Thief: pass\n", "thief")
    with pytest.raises(ConfigurationError, match="several packages"):
        make("stage", "serial", "stage1", STAGE)

"""What every driver promises: its operations, its values and its errors."""

import dataclasses
import inspect
import pickle

import numpy as np
import pytest

from drivers import protocols
from drivers.protocols import (
    LED_INTENSITY_LIMIT,
    Camera,
    CameraSettings,
    ConfigurationError,
    Frame,
    InstrumentError,
    Led,
    Position,
    Projector,
    Refused,
    Stage,
    check_intensity,
)
from drivers.stage.engine import SerialStage

PUBLIC = [getattr(protocols, name) for name in protocols.__all__]
ERRORS = [kind for kind in PUBLIC if inspect.isclass(kind) and issubclass(kind, InstrumentError)]
VALUES = [kind for kind in PUBLIC if dataclasses.is_dataclass(kind)]


def test_errors_are_a_closed_set() -> None:
    assert {kind.__name__ for kind in ERRORS} == {
        "InstrumentError",
        "NotConnected",
        "DeviceLost",
        "TimedOut",
        "Refused",
        "Unsupported",
        "LimitReached",
        "MotionFailed",
        "IncompleteFrame",
        "FramesLost",
        "DeviceFault",
        "GarbledReply",
        "ConfigurationError",
    }


@pytest.mark.parametrize("kind", ERRORS)
def test_an_error_names_the_device_and_the_remedy_in_one_line(kind: type[InstrumentError]) -> None:
    error = kind("stage1", "it is gone", "plug it in")
    assert str(error) == "stage1: it is gone (plug it in)"
    assert (error.device, error.what, error.remedy) == ("stage1", "it is gone", "plug it in")


@pytest.mark.parametrize("kind", ERRORS)
def test_an_error_survives_the_way_between_processes(kind: type[InstrumentError]) -> None:
    error = pickle.loads(pickle.dumps(kind("stage1", "it is gone", "plug it in")))
    assert type(error) is kind
    assert error.args == ("stage1", "it is gone", "plug it in")


def test_where_a_setting_is_wrong_survives_it_too() -> None:
    error = pickle.loads(pickle.dumps(ConfigurationError("stage1", "wrong", "correct it", ("axis", 1))))
    assert error.location == ("axis", 1)


@pytest.mark.parametrize("kind", VALUES)
def test_values_are_frozen_and_documented(kind: type) -> None:
    assert kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert kind.__doc__


@pytest.mark.parametrize("kind", [Camera, Projector, Stage])
def test_every_operation_is_documented(kind: type) -> None:
    operations = [value for name, value in inspect.getmembers(kind, callable) if not name.startswith("_")]
    assert len(operations) >= 9
    assert all(inspect.getdoc(operation) for operation in operations)


def test_a_value_cannot_be_changed() -> None:
    position = Position(1.0, measured=True)
    with pytest.raises(dataclasses.FrozenInstanceError):
        position.measured = False  # type: ignore[misc]
    assert CameraSettings() == CameraSettings(trigger="free")


def test_frames_are_compared_by_identity_as_arrays_have_no_single_answer() -> None:
    image = np.zeros((2, 2), np.uint8)
    frame = Frame(image, 8, 0, 7, None, 1.0, None)
    assert frame != Frame(image, 8, 0, 7, None, 1.0, None)


@pytest.mark.parametrize("intensity", [0.0, 0.3, LED_INTENSITY_LIMIT])
def test_an_led_may_be_driven_up_to_its_cap(intensity: float) -> None:
    assert check_intensity("projector", intensity) == intensity


@pytest.mark.parametrize("intensity", [0.6001, 1.0, 60.0, -0.1, float("nan"), float("inf")])
def test_an_led_is_never_driven_above_its_cap(intensity: float) -> None:
    with pytest.raises(Refused, match="E0031") as caught:
        check_intensity("projector", intensity)
    assert caught.value.device == "projector"


def test_leds_have_the_names_of_a_rig_file() -> None:
    assert [led.value for led in Led] == ["red", "green", "blue", "infrared"]


def test_the_serial_stage_is_a_stage() -> None:
    lacking = {name for name in dir(Stage) if not name.startswith("_")} - set(dir(SerialStage))
    assert lacking == set()

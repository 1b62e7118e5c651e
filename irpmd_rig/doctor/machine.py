"""What a driver needs of this machine: libraries, rights, a display. Asked only where an instrument is missing."""

from __future__ import annotations

import ctypes
import grp
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import usb.backend.libusb1
from serial.tools import list_ports

from irpmd_rig.acquisition.rig_file import Device
from irpmd_rig.doctor.report import Finding
from irpmd_rig.shipped import CONFIGS

UDEV_FOLDERS = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
X_SOCKETS = Path("/tmp/.X11-unix")
LOCAL_DISPLAY = re.compile(r"(?:unix)?:(\d+)")
RULES = CONFIGS / "udev" / "99-irpmd-rig.rules"


def lacking(device: Device) -> tuple[Finding, ...]:
    """Find what this machine lacks that the driver of an instrument needs."""
    checks = {
        "camera.harvesters": _genicam_camera,
        "camera.aravis": _aravis_camera,
        "projector.video": _screen,
        "projector.lightcommander": _usb_projector,
        "projector.dlpc350": _usb_projector,
        "stage.serial": _serial_stage,
    }
    check = checks.get(f"{device.kind}.{device.driver}")
    return tuple(check(device.settings)) if check else ()


def rights(devices: Iterable[Device]) -> tuple[Finding, ...]:
    """Find what keeps this user from the USB devices and serial lines of these instruments."""
    drivers = {f"{device.kind}.{device.driver}" for device in devices}
    usb_drivers = {"camera.harvesters", "projector.lightcommander", "projector.dlpc350"}
    found: list[Finding] = []
    if drivers & (usb_drivers | {"stage.serial"}):
        found += _rules()
    if drivers & usb_drivers:
        found += _group("plugdev")
    if "stage.serial" in drivers:
        found += _group("dialout")
    return tuple(found)


def _genicam_camera(settings: Mapping[str, Any]) -> Iterator[Finding]:  # noqa: ARG001 - one form for all
    yield from modules(("harvesters", "genicam"), "harvesters")


def _aravis_camera(settings: Mapping[str, Any]) -> Iterator[Finding]:
    library = str(settings.get("library", "libaravis-0.8.so.0"))
    yield from shared_library(library, "install Aravis (Debian: libaravis-0.8-0), or correct `library`")


def _usb_projector(settings: Mapping[str, Any]) -> Iterator[Finding]:
    if settings.get("library") is not None:
        yield from shared_library(str(settings["library"]), "correct `library`: the lab's own copy of TI's library")
    elif settings.get("backend") is None and usb.backend.libusb1.get_backend() is None:
        yield Finding("there is no libusb", "install it (Debian: libusb-1.0-0)")
    if isinstance(settings.get("video"), Mapping):
        yield from _screen(settings["video"])


def _screen(settings: Mapping[str, Any]) -> Iterator[Finding]:
    yield from modules(("sdl2", "sdl2dll"), "'irpmd-rig[screen]'")
    display = str(settings.get("x_display") or os.environ.get("DISPLAY", ""))
    number = LOCAL_DISPLAY.match(display)
    start = "on a machine without a desktop install xserver-xorg and start X on the projector's output"
    if not display:
        yield Finding("there is no X display in this session", f"set `x_display`; {start}")
    elif number and not (X_SOCKETS / f"X{number[1]}").exists():
        yield Finding(f"no X server runs as {display}", f"correct `x_display`; {start}")


def _serial_stage(settings: Mapping[str, Any]) -> Iterator[Finding]:
    port = str(settings.get("port", ""))
    if "://" not in port and not Path(port).exists():
        there = ", ".join(sorted(entry.device for entry in list_ports.comports())) or "none"
        yield Finding(f"there is no serial port {port}", f"plug it in, or correct `port`; this machine has: {there}")


def modules(names: tuple[str, ...], requirement: str) -> Iterator[Finding]:
    """Find Python modules that are not installed; installing `requirement` brings them."""
    without = [name for name in names if find_spec(name) is None]
    if without:
        yield Finding(f"not installed: {', '.join(without)}", f"pip install {requirement}")


def shared_library(name: str, remedy: str) -> Iterator[Finding]:
    """Find out whether a shared library cannot be loaded."""
    try:
        ctypes.CDLL(name)
    except OSError as error:
        yield Finding(f"the library {name} cannot be loaded: {error}", remedy)


def _rules() -> Iterator[Finding]:
    if not any((folder / RULES.name).is_file() for folder in UDEV_FOLDERS):
        yield Finding(
            "the udev rules are not installed, so that perhaps only root may use the instruments",
            f"sudo install -m 644 {RULES} /etc/udev/rules.d/ && sudo udevadm control --reload && sudo udevadm trigger",
        )


def _group(name: str) -> Iterator[Finding]:
    mine = {group.gr_name for group in grp.getgrall() if group.gr_gid in os.getgroups()}
    if os.getuid() != 0 and name not in mine:
        yield Finding(
            f"this user is not in the group {name}", f"sudo usermod -aG {name} $USER, then log out and in again"
        )

"""The simulated bus through plain pyusb: what a USB library promises must hold here, errors included."""

import errno
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import usb.core
import usb.util

from sims.projector.usb_backend import get_backend
from sims.projector.usb_bus import UsbBus
from sims.projector.usb_device import Endpoint, Identity, UsbDevice
from tests.small_world import until


class Echo(UsbDevice):
    """Sends back what it receives."""

    def __init__(self, serial_number: str = "echo-1", **options) -> None:
        endpoints = (Endpoint(0x02, 2, 512), Endpoint(0x86, 2, 512))
        super().__init__(Identity(0xFFF0, 0x0001, "nobody", "echo", serial_number, 0xFF, endpoints), **options)

    def take(self, endpoint: int, data: bytes) -> None:
        self.queue(endpoint + 0x84, data)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[UsbBus]:
    bus = UsbBus(tmp_path / "usb")
    bus.start()
    yield bus
    bus.close()


@pytest.fixture
def echo(bus: UsbBus) -> Echo:
    echo = Echo()
    bus.add(echo)
    return echo


@pytest.fixture
def backend(bus: UsbBus):
    backend = get_backend(bus.socket_path)
    yield backend
    backend.finalize()


@pytest.fixture
def device(echo: Echo, backend) -> Iterator[usb.core.Device]:  # noqa: ARG001
    device = usb.core.find(backend=backend, idVendor=0xFFF0)
    device.set_configuration()
    yield device
    usb.util.dispose_resources(device)


def test_a_device_is_found_with_its_descriptors_and_strings(device: usb.core.Device) -> None:
    assert (device.idVendor, device.idProduct, device.bus, device.address) == (0xFFF0, 1, 1, 1)
    assert (device.manufacturer, device.product, device.serial_number) == ("nobody", "echo", "echo-1")
    interface = device.get_active_configuration()[(0, 0)]
    assert [endpoint.bEndpointAddress for endpoint in interface] == [0x02, 0x86]
    assert "echo" in str(device)


def test_bytes_go_out_and_come_back(device: usb.core.Device) -> None:
    assert device.write(0x02, b"hello") == 5
    assert bytes(device.read(0x86, 512)) == b"hello"
    assert device.write(0x02, bytes(98304)) == 98304
    assert bytes(device.read(0x86, 98304)) == bytes(98304)


def test_a_read_returns_at_a_short_packet_and_keeps_the_rest(device: usb.core.Device) -> None:
    device.write(0x02, bytes(700))
    device.write(0x02, b"next")
    assert len(device.read(0x86, 4096)) == 700
    assert bytes(device.read(0x86, 4096)) == b"next"


def test_a_packet_longer_than_the_buffer_overflows(device: usb.core.Device) -> None:
    device.write(0x02, bytes(100))
    with pytest.raises(usb.core.USBError) as caught:
        device.read(0x86, 10)
    assert caught.value.errno == errno.EOVERFLOW


def test_a_read_without_data_times_out_in_time(device: usb.core.Device) -> None:
    begun_s = time.monotonic()
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        device.read(0x86, 512, timeout=100)
    assert caught.value.errno == errno.ETIMEDOUT
    # pyusb's own default is a second, and some backends know no bound.
    assert 0.1 <= time.monotonic() - begun_s < 30


def test_a_write_before_the_configuration_is_set_fails(echo: Echo, backend) -> None:  # noqa: ARG001
    device = usb.core.find(backend=backend, idVendor=0xFFF0)
    with pytest.raises(usb.core.USBError, match="Configuration not set"):
        device.write(0x02, b"x")
    usb.util.dispose_resources(device)


def test_a_stall_halts_the_endpoint_until_it_is_cleared(echo: Echo, device: usb.core.Device) -> None:
    echo.usb_faults.stall_next()
    for _ in range(2):
        with pytest.raises(usb.core.USBError) as caught:
            device.write(0x02, b"x")
        assert caught.value.errno == errno.EPIPE
    device.clear_halt(0x02)
    device.write(0x02, b"x")
    assert bytes(device.read(0x86, 512)) == b"x"


def test_transfers_can_be_made_to_time_out_and_replies_to_be_garbled(echo: Echo, device: usb.core.Device) -> None:
    echo.usb_faults.time_out_next()
    with pytest.raises(usb.core.USBTimeoutError):
        device.write(0x02, b"x", timeout=30)
    echo.usb_faults.garble_next()
    device.write(0x02, b"\x00\xff")
    assert bytes(device.read(0x86, 512)) == b"\x55\xaa"
    echo.usb_faults.mute = True
    device.write(0x02, b"x")
    with pytest.raises(usb.core.USBTimeoutError):
        device.read(0x86, 512, timeout=30)
    echo.usb_faults.clear()
    assert bytes(device.read(0x86, 512)) == b"x"


def test_unplugging_ends_a_read_under_way_and_a_replugged_device_must_be_found_again(
    echo: Echo, device: usb.core.Device, backend
) -> None:
    threading.Timer(0.1, echo.usb_faults.unplug).start()
    with pytest.raises(usb.core.USBError) as caught:
        device.read(0x86, 512, timeout=100_000)
    assert caught.value.errno == errno.ENODEV
    assert usb.core.find(backend=backend, idVendor=0xFFF0) is None
    echo.usb_faults.replug()
    with pytest.raises(usb.core.USBError) as caught:
        device.write(0x02, b"x")
    assert caught.value.errno == errno.ENODEV
    again = usb.core.find(backend=backend, idVendor=0xFFF0)
    assert again.address == 2
    again.set_configuration()
    again.write(0x02, b"x")
    assert bytes(again.read(0x86, 512)) == b"x"
    usb.util.dispose_resources(again)


def test_writing_is_possible_while_another_thread_waits_to_read(device: usb.core.Device) -> None:
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(bytes(device.read(0x86, 512, timeout=30_000))))
    reader.start()
    time.sleep(0.05)
    device.write(0x02, b"now")
    reader.join(30)
    assert got == [b"now"]


def test_an_interface_belongs_to_one_process_until_it_ends(bus: UsbBus, device: usb.core.Device, backend) -> None:
    other_process = f"""
import usb.core
from sims.projector.usb_backend import get_backend
device = usb.core.find(backend=get_backend({str(bus.socket_path)!r}), idVendor=0xFFF0)
device.set_configuration()
try:
    device.write(0x02, b"mine")
except usb.core.USBError as error:
    raise SystemExit(error.errno)
"""
    device.write(0x02, b"x")
    threads = threading.active_count()
    run = [sys.executable, "-c", other_process]
    assert subprocess.run(run, timeout=60, check=False).returncode == errno.EBUSY
    usb.util.dispose_resources(device)
    assert subprocess.run(run, timeout=60, check=False).returncode == 0
    # The bus's thread for a client ends a moment after it.
    until(lambda: threading.active_count() <= threads)
    again = usb.core.find(backend=backend, idVendor=0xFFF0)
    assert bytes(again.read(0x86, 512)) == b"x"
    usb.util.dispose_resources(again)


def test_a_dead_process_swallows_nothing(bus: UsbBus, echo: Echo, backend) -> None:
    reading = f"""
import usb.core
from sims.projector.usb_backend import get_backend
device = usb.core.find(backend=get_backend({str(bus.socket_path)!r}), idVendor=0xFFF0)
device.set_configuration()
print("reading", flush=True)
device.read(0x86, 512, timeout=0)
"""
    threads = threading.active_count()
    run = [sys.executable, "-c", reading]
    with subprocess.Popen(run, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "reading\n"
        time.sleep(0.1)
        process.kill()
    until(lambda: threading.active_count() <= threads)
    echo.queue(0x86, b"late")
    device = usb.core.find(backend=backend, idVendor=0xFFF0)
    device.set_configuration()
    assert bytes(device.read(0x86, 512)) == b"late"
    usb.util.dispose_resources(device)


def test_two_devices_are_told_apart_by_serial_number(bus: UsbBus, echo: Echo, backend) -> None:  # noqa: ARG001
    bus.add(Echo("echo-2"))
    found = usb.core.find(backend=backend, find_all=True)
    assert [device.serial_number for device in found] == ["echo-1", "echo-2"]


def test_without_a_world_nothing_is_found_and_an_open_device_is_gone(tmp_path: Path) -> None:
    backend = get_backend(tmp_path / "usb")
    assert usb.core.find(backend=backend) is None
    bus = UsbBus(tmp_path / "usb")
    bus.add(Echo())
    bus.start()
    device = usb.core.find(backend=backend)
    device.set_configuration()
    bus.close()
    with pytest.raises(usb.core.USBError) as caught:
        device.write(0x02, b"x")
    assert caught.value.errno == errno.ENODEV
    assert usb.core.find(backend=backend) is None
    usb.util.dispose_resources(device)
    backend.finalize()


def test_nothing_stays_behind(tmp_path: Path) -> None:
    def count() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    before = count()
    for _ in range(3):
        bus = UsbBus(tmp_path / "usb")
        echo = Echo()
        bus.add(echo)
        bus.start()
        backend = get_backend(bus.socket_path)
        device = usb.core.find(backend=backend)
        device.set_configuration()
        device.write(0x02, b"x")
        echo.usb_faults.unplug()
        usb.util.dispose_resources(device)
        backend.finalize()
        bus.close()
        bus.close()
    assert count() == before
    assert not (tmp_path / "usb").exists()

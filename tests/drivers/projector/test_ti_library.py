"""TI's API by ctypes, on a library of a few lines that says what it was called with."""

import errno
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError, DeviceFault, DeviceLost, InstrumentError, NotConnected, TimedOut
from drivers.projector.lightcommander import LightCommander
from drivers.protocols import Led, PatternSequence
from drivers.registry import make

# The types are those of TI's header. What the library is told to do stands in the file $FAKE_TI.
SOURCE = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
typedef unsigned char Byte; typedef unsigned short UInt16; typedef unsigned int UInt32; typedef int Status;
typedef void (*OutputCallback)(const char *);
static OutputCallback output;
static void path(char *name, const char *what) { sprintf(name, "%s.%s", getenv("FAKE_TI"), what); }
static Status said(const char *what) {
    char name[512], wish[64] = "";
    path(name, "log"); FILE *log = fopen(name, "a"); fprintf(log, "%s\n", what); fclose(log);
    path(name, "wish"); FILE *file = fopen(name, "r");
    if (file) { if (!fgets(wish, sizeof wish, file)) wish[0] = 0; fclose(file); remove(name); }
    if (!strncmp(wish, "hang", 4)) sleep(60);
    if (!strncmp(wish, "crash", 5)) abort();
    if (output) output(what);
    return !strncmp(wish, "fail", 4);
}
#define SAY(...) char line[256]; sprintf(line, __VA_ARGS__); return said(line)
#define NOTHING(f) Status f(void) { return said(#f); }
#define BYTE(f, v) Status f(Byte *out) { *out = v; return said(#f); }
Status InitPortabilityLayer(Byte level, Byte detail, OutputCallback callback) {
    output = callback; SAY("Init %d %d", level, detail); }
NOTHING(DLP_Display_DisplayPatternManualForceFirstPattern) NOTHING(DLP_Display_DisplayPatternManualStep)
NOTHING(DLP_Display_DisplayPatternAutoStepForSinglePass) NOTHING(DLP_Display_DisplayStop)
NOTHING(DLP_Display_DisplayPatternAutoStepRepeatForMultiplePasses) NOTHING(DLP_Display_ParkDMD)
NOTHING(DLP_Display_UnparkDMD) NOTHING(DLP_Status_CommunicationStatus)
BYTE(DLP_Status_GetDMDparkState, 0) BYTE(DLP_Status_GetSeqRunState, 1) BYTE(DLP_Status_GetSeqDataBPP, 8)
BYTE(DLP_Status_GetLEDdriverFault, 0)
BYTE(DLP_Status_GetOverallLEDdriverTempTimeoutState, 0)
Status DLP_Status_GetSeqDataExposure(double *us) { *us = 20000.0; return said("GetSeqDataExposure"); }
Status DLP_Img_DownloadBitplanePatternToExtMem(Byte b[], UInt32 n, UInt16 plane) {
    UInt32 sum = 0; for (UInt32 i = 0; i < n; i++) sum += b[i];
    SAY("Download %u bytes, sum %u, plane %u", n, sum, plane); }
Status DLP_RegIO_WriteImageOrderLut(Byte bpp, UInt16 order[], UInt16 n) {
    SAY("WriteImageOrderLut %d bits, %d of them, first %d, last %d", bpp, n, order[0], order[n - 1]); }
Status RunBatchFile(const char *name, int stop) { SAY("RunBatchFile %s %d", strrchr(name, '/') + 1, stop); }
Status DLP_LED_SetLEDEnable(int led, Byte on) { SAY("SetLEDEnable %d %d", led, on); }
Status DLP_LED_SetLEDintensity(int led, double percent) { SAY("SetLEDintensity %d %g", led, percent); }
Status DLP_LED_LEDdriverEnable(Byte on) { SAY("LEDdriverEnable %d", on); }
Status DLP_Sync_Configure(Byte n, Byte polarity, UInt32 delay, UInt32 width) {
    SAY("Sync_Configure %d %d %u %u", n, polarity, delay, width); }
Status DLP_Sync_SetEnable(Byte n, Byte on) { SAY("Sync_SetEnable %d %d", n, on); }
Status DLP_Source_SetDataSource(int source) { SAY("SetDataSource %d", source); }
Status DLP_Status_GetMCUversionString(char *text, int size) { snprintf(text, size, "1.2.3"); return said("version"); }
"""


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("ti")
    (folder / "fake.c").write_text(SOURCE)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", folder / "libti.so", folder / "fake.c"], check=True)
    return folder / "libti.so"


class Fake:
    """The library's log, and what it is to do in its next call."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def log(self) -> list[str]:
        return Path(f"{self.place}.log").read_text().splitlines()

    def forget(self) -> None:
        Path(f"{self.place}.log").write_text("")

    def wish(self, what: str) -> None:
        Path(f"{self.place}.wish").write_text(what)


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    monkeypatch.setenv("FAKE_TI", str(tmp_path / "fake"))
    return Fake(tmp_path / "fake")


@pytest.fixture
def driver(fake: Fake, library: Path, compiled: Callable[..., str]) -> Iterator[LightCommander]:
    made = by_library(library, compiled)
    fake.forget()
    yield made
    made.close()


def by_library(library: Path, compiled: Callable[..., str]) -> LightCommander:
    values = {
        "transport": "ti_library",
        "library": str(library),
        "timeout_s": 1.5,
        "sequences": (compiled(20_000, 25_000),),
    }
    driver = make("projector", "lightcommander", "projector1", values)
    assert isinstance(driver, LightCommander)
    return driver


def test_calls_of_the_library_in_order(fake: Fake, driver: LightCommander) -> None:
    driver.open()
    assert "firmware 1.2.3" in driver.capabilities().model
    assert fake.log() == [
        "Init 0 0",
        "DLP_Status_CommunicationStatus",
        "version",
        "LEDdriverEnable 0",
        "DLP_Display_DisplayStop",
        "SetLEDEnable 0 0",
        "SetLEDEnable 1 0",
        "SetLEDEnable 2 0",
        "SetLEDEnable 3 0",
        "DLP_Display_UnparkDMD",
        "SetDataSource 3",
    ]
    fake.forget()
    driver.load(np.full((1, 768, 1024), 0x81, np.uint8))
    full, empty = 98304 * 255, 0
    assert fake.log() == [
        f"Download 98304 bytes, sum {full if bit in (0, 7) else empty}, plane {bit}" for bit in range(8)
    ]
    fake.forget()
    driver.set_led(Led.INFRARED, 0.55)
    assert fake.log()[:6] == [
        "SetLEDEnable 0 0",
        "SetLEDEnable 1 0",
        "SetLEDEnable 2 0",
        "SetLEDintensity 3 55",
        "SetLEDEnable 3 1",
        "LEDdriverEnable 1",
    ]
    fake.forget()
    taken = driver.order(PatternSequence((0, 0, 0), exposure_us=20_000))
    assert taken.period_us == 25_000
    assert fake.log() == [
        "RunBatchFile 20000-25000-8-all.bf 1",
        "DLP_Status_GetSeqDataBPP",
        "GetSeqDataExposure",
        "WriteImageOrderLut 8 bits, 3 of them, first 0, last 0",
    ]
    fake.forget()
    driver.run_once()
    assert fake.log()[0] == "DLP_Display_DisplayPatternAutoStepForSinglePass"
    fake.forget()
    driver.close()
    assert fake.log()[0] == "LEDdriverEnable 0"


def fails(operation: Callable[[], object], kind: type[InstrumentError]) -> InstrumentError:
    begun_s = time.monotonic()
    with pytest.raises(kind) as caught:
        operation()
    # Its bounds are a few seconds, and what hangs has no end.
    assert time.monotonic() - begun_s < 40.0
    return caught.value


@pytest.mark.parametrize(("wish", "kind"), [("fail", DeviceFault), ("hang", TimedOut), ("crash", DeviceLost)])
def test_a_library_that_fails_hangs_or_crashes(
    fake: Fake, driver: LightCommander, wish: str, kind: type[InstrumentError]
) -> None:
    driver.open()
    driver.load(np.zeros((1, 768, 1024), np.uint8))
    driver.set_led(Led.RED, 0.2)
    fake.forget()
    fake.wish(wish)
    fails(lambda: driver.show(0), kind)
    # A new process tells the box to turn the light off.
    assert "LEDdriverEnable 0" in fake.log()
    assert "Init 0 0" in fake.log()
    fake.forget()
    driver.load(np.zeros((1, 768, 1024), np.uint8))
    # Nothing is believed of a box that may have been switched off and on: it is set up anew, and the same planes sent.
    assert "DLP_Display_UnparkDMD" in fake.log()
    assert sum(entry.startswith("Download") for entry in fake.log()) == 8
    driver.set_led(Led.RED, 0.2)
    driver.show(0)


def test_no_box(fake: Fake, driver: LightCommander) -> None:
    fake.wish("fail")
    assert "finds no LightCommander" in fails(driver.open, NotConnected).what
    driver.open()


def test_a_library_that_is_none(compiled: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "text.so").write_text("no library")
    for path, what in ((tmp_path / "text.so", "cannot be loaded"), ("libm.so.6", "lacks InitPortabilityLayer")):
        driver = by_library(Path(path), compiled)
        assert what in fails(driver.open, ConfigurationError).what


def test_no_process_stays_behind(driver: LightCommander, leftovers: Callable[[], object]) -> None:
    before = leftovers()
    for _ in range(2):
        driver.open()
        child = driver._transport._child  # type: ignore[attr-defined]
        driver.close()
        assert child._process.returncode == 0
    assert leftovers() == before


def test_a_library_that_hangs_does_not_outlive_the_program(fake: Fake, library: Path) -> None:
    code = (
        "from pathlib import Path\n"
        "from drivers.projector.child import Child\n"
        f"child = Child('p', 'drivers.projector.ti_process', {{'library': {str(library)!r}}})\n"
        "child.greet()\n"
        f"Path('{fake.place}.wish').write_text('hang')\n"
        "print(child._process.pid, flush=True)\n"
        "child.call('DLP_Display_DisplayStop', timeout_s=50, values={})\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        status = Path(f"/proc/{int(program.stdout.readline())}/stat")
        end_s = time.monotonic() + 30.0
        # The library takes the wish when it is called.
        while Path(f"{fake.place}.wish").exists() and time.monotonic() < end_s:
            time.sleep(0.02)
        program.kill()
    end_s = time.monotonic() + 30.0
    while status.exists() and ") Z " not in status.read_text() and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not status.exists() or ") Z " in status.read_text()


def test_no_process_can_be_started(
    driver: LightCommander, leftovers: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    before = leftovers()
    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "Popen", refuse)
        assert "cannot be started" in fails(driver.open, NotConnected).what
    assert leftovers() == before
    driver.open()


def test_what_lies_in_the_working_folder_does_not_matter(
    driver: LightCommander, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("drivers", "numpy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit(1)")
    monkeypatch.chdir(tmp_path)
    driver.open()


@pytest.mark.parametrize(
    "change",
    [
        {"transport": "usb"},
        {"library": None},
        {"profile": "lightcommander-sim"},
        {"backend": "a:b"},
        {"sequences": ()},
        {"video": {"display": 0}},
    ],
)
def test_settings_that_contradict_each_other(
    library: Path, compiled: Callable[..., str], change: dict[str, object]
) -> None:
    values = {"transport": "ti_library", "library": str(library), "sequences": (compiled(20_000, 25_000),)}
    with pytest.raises(ConfigurationError):
        make("projector", "lightcommander", "projector1", values | change)

"""Where GenTL producers are found."""

import ctypes
import os
from pathlib import Path

from drivers.errors import ConfigurationError, NotConnected

VARIABLE = "GENICAM_GENTL64_PATH"
XIMEA_NAMES = ("ximea.gentl2.cti", "ximea.gentl.cti", "libXIMEA_GenTL.cti", "libxiFapi_GenTL.cti")
XIMEA_FOLDERS = (Path("/opt/XIMEA/lib"), Path("/opt/XIMEA/lib64"), Path("/usr/lib"), Path("/usr/local/lib"))


def producers(device: str, named: str | None) -> tuple[Path, ...]:
    """Return the producers to load.

    Parameters
    ----------
    device
        Name of the camera.
    named
        The setting; None: the first XIMEA producer in the folders of GENICAM_GENTL64_PATH or where XIMEA's
        software puts it, else every producer in the folders of GENICAM_GENTL64_PATH.

    Raises
    ------
    ConfigurationError
        The setting names no producer.
    NotConnected
        There is none.
    """
    if named is not None:
        return (_checked(device, Path(named).expanduser()),)
    folders = [Path(folder) for folder in os.environ.get(VARIABLE, "").split(os.pathsep) if folder]
    for folder in (*folders, *XIMEA_FOLDERS):
        for name in XIMEA_NAMES:
            if (folder / name).is_file():
                return (folder / name,)
    found = tuple(path for folder in folders if folder.is_dir() for path in sorted(folder.glob("*.cti")))
    if not found:
        raise NotConnected(
            device,
            "no GenTL producer was found",
            f"install the camera maker's software, and set `producer` to its .cti file, or {VARIABLE} to its folder",
        )
    return found


def _checked(device: str, path: Path) -> Path:
    if not path.is_file():
        raise ConfigurationError(
            device, f"the producer {path} does not exist", "set `producer` to a .cti file", ("producer",)
        )
    try:
        ctypes.CDLL(str(path))
    except OSError as error:
        raise ConfigurationError(
            device, f"the producer {path} cannot be loaded: {error}", "set `producer` to a .cti file of this computer",
            ("producer",),
        ) from None  # fmt: skip
    return path

"""The rig over HTTP: resources, events, files, figures; RFC 9457 problems for whatever goes wrong."""

from irpmd_rig.service.app import create_app
from irpmd_rig.service.serve import serve
from irpmd_rig.service.settings import ServiceSettings

__all__ = ["ServiceSettings", "create_app", "serve"]

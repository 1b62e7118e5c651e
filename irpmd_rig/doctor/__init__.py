"""Looks at a rig's instruments: what is there, what is missing, and how it is mended."""

from irpmd_rig.doctor.command import doctor

__all__ = ["doctor"]

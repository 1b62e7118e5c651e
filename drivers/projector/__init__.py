"""Projectors: a full-screen window on a video output, the DLP LightCommander, and TI's DLPC350 (LightCrafter 4500)."""

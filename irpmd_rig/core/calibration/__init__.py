"""Calibration from frames: camera, plate, planes and distance."""

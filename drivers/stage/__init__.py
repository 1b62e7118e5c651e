"""Stages on a serial line: one engine, one dialect file a controller."""

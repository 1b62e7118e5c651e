"""Simulated projectors: USB devices behind a bus of their own, and a screen taken as the video input."""

"""The world's process: all instruments of one world, served together over what their drivers speak.

What the projector shows, where the stages are and when the camera exposes meet in one physics
(`sims.process.physics`). `python -m sims serve` starts it.
"""

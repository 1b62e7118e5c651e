"""The simulated world of the rig: its truth, its optics, its sensor.

Nothing of the measurement is imported here and nothing here is imported by it: optics that share code with a
reconstruction prove nothing about it.
"""

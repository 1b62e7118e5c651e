"""The demonstration: a simulated rig calibrates itself and measures."""

"""Infrared phase-measuring deflectometry: the shape of mirror-like, also discontinuous, objects."""

"""Drivers of the rig's camera, projector and stages: `protocols` says what they do, `registry` finds them."""

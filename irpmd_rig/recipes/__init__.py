"""Recipes: what a person asks of the rig, in YAML, read with line numbers and checked before anything moves.

A recipe is a mapping with a ``kind`` and the fields of that kind; `irpmd_rig.recipes.models` says what each means and
its unit. Unknown keys are refused. Everything that is wrong is told at once, each with line, column and remedy.

===================  ============================================================  ======================
kind                 what the rig does                                             fields of its own
===================  ============================================================  ======================
calibrate-camera     checkerboard in many poses, the last on the plate of stage2   `CalibrateCamera`
calibrate-plate      white plate at many positions of stage2                       `CalibratePlate`
calibrate-geometry   sprayed mirror, glass, mirror with glass at stage1 = 0        `CalibrateGeometry`
reference            reference mirror at the positions of stage1                   `Reference`
measure              object at the same positions                                  `Measure`
sequence             show, capture, move, wait, prompt, set in any order           `Sequence`
align                glass turned by the operator until it is parallel             `Align`
characterise         gamma, delay, settle, stage-axis, focus or exposure           `Characterise`
===================  ============================================================  ======================

Each calibration names the one before it: camera, plate, geometry, reference; a measurement names its geometry and its
reference. A name is the id of a run, or ``active``.

Modules: `document` reads any YAML document into a model; `reading` a recipe; `plan` lays out its stations, estimates
and checks them.
"""

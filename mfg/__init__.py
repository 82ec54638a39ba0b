"""Voxel design in, blueprint out, or a typed reason why not.

A pipeline is one ordered tuple of solvers (`mfg.pipeline`); each takes the `Blueprint` and returns a new one, or a
`Failure`. Body-scale work happens on signed-distance fields (`mfg.fields`), hardware features are exact booleans on
solids (`mfg.solids`).
"""

"""Latent or sketch in, voxel body with joints out.

`VoxelDesign` (`decoder.design`) is the type every other layer starts from. `decoder.vae` decodes a latent z in R^512 as
it was taught, `decoder.genome` by a procedure, and `decoder.sketch` reads painted voxels. The decoder never judges:
whether a body can be built is the verdict of the solvers in `mfg`.
"""

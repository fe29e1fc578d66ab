"""File formats: 3DGS ply, spz, PyTorch files, strict JSON, images, masks and depth maps."""

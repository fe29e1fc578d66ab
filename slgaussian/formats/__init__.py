"""File formats and texts: 3DGS ply, safetensors, strict JSON, images, and how objects print."""

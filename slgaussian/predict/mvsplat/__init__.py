"""MVSplat, which predicts Gaussians from posed photographs with published weights.

Chen et al., "MVSplat: Efficient 3D Gaussian Splatting from Sparse Multi-View Images", ECCV 2024,
arXiv:2403.14627. The stages, in order: ``backbone`` (with ``transformer``), ``cost_volume``,
``depth`` (with ``unet``), ``adapter``; ``network`` joins the first three, ``checkpoint`` fills it
with weights, ``predictor`` is what a user calls.
"""

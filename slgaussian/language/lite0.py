"""EfficientNet-Lite0 (Tan and Le, ICML 2019, without squeeze-and-excitation) in OpenCV.

OpenCV takes three quarters of PyTorch's time, and gives the same bits on any number of threads.
This module therefore folds batch normalisation into the convolutions, and builds an ONNX model
(https://github.com/onnx/onnx/blob/main/onnx/onnx.proto) in memory for OpenCV.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np

STAGES = ((1, 1, 1), (2, 2, 6), (2, 2, 6), (3, 2, 6), (3, 1, 6), (4, 2, 6), (1, 1, 6))
"""Stages of EfficientNet-B0: blocks, stride of the first block, expansion of the channels."""

EPSILON = 1e-3
"""Epsilon of batch normalisation."""


def load_network(weights: dict[str, np.ndarray]) -> cv2.dnn.Net:
    """Build the network: from float32 [1, 3, H, W] to logits [1, 1000, H/32, W/32] of cells.

    H and W may be any multiples of 32; the input is RGB, (x - 127) / 128. Each cell is averaged
    with its neighbours before the last layer, because the network was trained on means of 7 x 7
    cells, and a single cell carries too little evidence.

    Args:
        weights: dict of str to array. The layers' tensors by name.
    """
    nodes: list[bytes] = []
    tensors: list[bytes] = []

    def add(operator: str, *inputs: str, **attributes: int | float | tuple[int, ...]) -> str:
        output = f"{operator}{len(nodes)}"
        nodes.append(
            _message(
                *((1, name) for name in inputs),
                (2, output),
                (4, operator),
                *((5, _attribute(name, value)) for name, value in attributes.items()),
            )
        )
        return output

    def convolve(x: str, name: str, kernel: np.ndarray, bias: np.ndarray, stride: int = 1) -> str:
        tensors.extend((_tensor(f"{name}.kernel", kernel), _tensor(f"{name}.bias", bias)))
        size = kernel.shape[2]
        padding = size - stride  # TensorFlow's ``SAME`` padding, if the stride divides the side
        before, after = padding // 2, padding - padding // 2
        return add(
            "Conv",
            x,
            f"{name}.kernel",
            f"{name}.bias",
            kernel_shape=(size, size),
            strides=(stride, stride),
            pads=(before, before, after, after),
            group=len(kernel) if kernel.shape[1] == 1 else 1,
        )

    def normalize(x: str, name: str, norm: str, stride: int = 1, clip: bool = True) -> str:
        scale = weights[f"{norm}.weight"] / np.sqrt(weights[f"{norm}.running_var"] + EPSILON)
        bias = weights[f"{norm}.bias"] - weights[f"{norm}.running_mean"] * scale
        kernel = weights[f"{name}.weight"] * scale[:, None, None, None]
        y = convolve(x, name, kernel, bias, stride)
        # OpenCV's own operator: it is fused into the convolution, unlike ONNX's Clip.
        return add("ReLU6", y, min_value=0.0, max_value=6.0) if clip else y

    x = normalize("image", "_conv_stem", "_bn0", 2)
    blocks = (
        (stride if repeat == 0 else 1, expansion, repeat > 0)
        for repeats, stride, expansion in STAGES
        for repeat in range(repeats)
    )
    for number, (stride, expansion, skips) in enumerate(blocks):
        block = f"_blocks.{number}."
        y = normalize(x, f"{block}_expand_conv", f"{block}_bn0") if expansion > 1 else x
        y = normalize(y, f"{block}_depthwise_conv", f"{block}_bn1", stride)
        y = normalize(y, f"{block}_project_conv", f"{block}_bn2", clip=False)
        x = add("Add", x, y) if skips else y
    x = normalize(x, "_conv_head", "_bn1")
    x = add("AveragePool", x, kernel_shape=(3, 3), pads=(1, 1, 1, 1), count_include_pad=0)
    x = convolve(x, "_fc", weights["_fc.weight"][:, :, None, None], weights["_fc.bias"])
    graph = _message(
        *((1, node) for node in nodes),
        (2, "lite0"),
        *((5, tensor) for tensor in tensors),
        (11, _value("image", (1, 3, 32, 32))),
        (12, _value(x, (1, 1000, 1, 1))),
    )
    model = _message((1, 5), (8, _message((2, 9))), (7, graph))  # IR 5, operators of version 9
    return cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))


def _message(*fields: tuple[int, int | float | str | bytes]) -> bytes:
    """Encode fields of (number, value) as Protocol Buffers do."""
    parts = []
    for number, value in fields:
        if isinstance(value, int):
            parts.append(_varint(number << 3) + _varint(value))
        elif isinstance(value, float):
            parts.append(_varint(number << 3 | 5) + struct.pack("<f", value))
        else:
            content = value.encode() if isinstance(value, str) else value
            parts.append(_varint(number << 3 | 2) + _varint(len(content)) + content)
    return b"".join(parts)


def _varint(number: int) -> bytes:
    groups = [number >> shift & 127 for shift in range(0, max(1, number.bit_length()), 7)]
    return bytes([*(group | 128 for group in groups[:-1]), groups[-1]])


def _attribute(name: str, value: int | float | tuple[int, ...]) -> bytes:
    if isinstance(value, tuple):
        return _message((1, name), *((8, number) for number in value), (20, 7))
    field, kind = (2, 1) if isinstance(value, float) else (3, 2)
    return _message((1, name), (field, value), (20, kind))


def _tensor(name: str, array: np.ndarray) -> bytes:
    content = np.ascontiguousarray(array, "<f4").tobytes()
    return _message(*((1, side) for side in array.shape), (2, 1), (8, name), (9, content))


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    sides = _message(*((1, _message((1, side))) for side in shape))
    return _message((1, name), (2, _message((1, _message((1, 1), (2, sides))))))

"""Small SAM and SAM 2 with random weights, for tests; their masks are meaningless.

They have the architecture of the published models, so that folders, shapes and prompts are real.
Weights are drawn larger than usual and the head of predicted IoUs leans high, or no mask would be
good enough to be kept.
"""

from pathlib import Path

import torch
import transformers

SIDE = 64
"""Of the square that the networks look at."""


def draw_weights(model) -> None:
    """Draw all matrices of a model at random, always the same."""
    state = torch.Generator().manual_seed(1)
    for _, tensor in sorted(model.named_parameters()):
        if tensor.ndim > 1:
            spread = tensor[0].numel() ** -0.5
            tensor.data.copy_(torch.randn(tensor.shape, generator=state) * spread)


def _save(model, iou_bias: float, folder: Path) -> Path:
    draw_weights(model)
    for name, tensor in model.named_parameters():
        if "output_hypernetworks_mlps" in name and "proj_out" in name:
            tensor.data.mul_(300)
    model.mask_decoder.iou_prediction_head.proj_out.bias.data.fill_(iou_bias)
    model.save_pretrained(folder)
    return folder


def save_sam(folder: Path) -> Path:
    torch.manual_seed(0)
    config = transformers.SamConfig(
        vision_config=transformers.SamVisionConfig(
            hidden_size=16,
            output_channels=32,
            num_hidden_layers=2,
            num_attention_heads=2,
            image_size=SIDE,
            patch_size=8,
            window_size=4,
            global_attn_indexes=[1],
            num_pos_feats=16,
            mlp_dim=32,
            initializer_range=0.02,
        ).to_dict(),
        prompt_encoder_config=transformers.SamPromptEncoderConfig(
            hidden_size=32, image_size=SIDE, patch_size=8, mask_input_channels=4
        ).to_dict(),
        mask_decoder_config=transformers.SamMaskDecoderConfig(
            hidden_size=32, mlp_dim=32, num_attention_heads=2, iou_head_hidden_dim=32
        ).to_dict(),
    )
    return _save(transformers.SamModel(config), 0.9, folder)


def sam2_config() -> dict:
    return {
        "vision_config": transformers.Sam2VisionConfig(
            backbone_config=transformers.Sam2HieraDetConfig(
                hidden_size=8,
                image_size=[SIDE, SIDE],
                blocks_per_stage=[1, 1, 2, 1],
                embed_dim_per_stage=[8, 16, 32, 64],
                num_attention_heads_per_stage=[1, 1, 2, 2],
                window_size_per_stage=[4, 2, 2, 2],
                window_positional_embedding_background_size=[4, 4],
                global_attention_blocks=[3],
            ).to_dict(),
            backbone_channel_list=[64, 32, 16, 8],
            backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]],
            fpn_hidden_size=32,
        ).to_dict(),
        "prompt_encoder_config": transformers.Sam2PromptEncoderConfig(
            hidden_size=32, image_size=SIDE, patch_size=16, mask_input_channels=4
        ).to_dict(),
        "mask_decoder_config": transformers.Sam2MaskDecoderConfig(
            hidden_size=32, mlp_dim=32, num_attention_heads=2, iou_head_hidden_dim=32
        ).to_dict(),
    }


def save_sam2(folder: Path) -> Path:
    torch.manual_seed(0)
    config = transformers.Sam2Config(**sam2_config())
    return _save(transformers.Sam2Model(config), 2.5, folder)

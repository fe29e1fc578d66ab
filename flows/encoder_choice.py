"""The encoder ``auto``: CLIP where its weights are on this machine, else the lexicon.

It is settled where settings are read, and said. What is built, stored and reported knows the
encoder that was taken, never ``auto``. Nothing is ever downloaded for it.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from slgaussian.errors import InputError
from slgaussian.language.configs import CLIP, ClipConfig

AUTO = "auto"

CANDIDATES = ("clip", "lexicon")
"""The encoders that it may become: tables of both may be given."""


def find_clip(config: ClipConfig) -> tuple[str | None, str]:
    """Find the CLIP to take; None if there is none on this machine; and the reason."""
    from slgaussian.components.hub_cache import cached_models

    model, tokenizer = str(config.model), config.tokenizer
    if find_spec("transformers") is None:
        return None, "CLIP needs the package transformers, which is not installed"
    if _usable(model, tokenizer):
        return model, f"{model} is on this machine"
    if model != CLIP:
        return None, f"{model} is no whole CLIP with its tokenizer on this machine"
    others = [name for name, folder in cached_models() if _usable(folder, tokenizer)]
    if len(others) == 1:
        return others[0], f"{others[0]} is the one CLIP in the hub's cache"
    if others:
        names = ", ".join(others)
        return None, f"the hub's cache holds several of CLIP ({names}); name one as clip.model"
    return None, f"no CLIP is on this machine (`hf download {model}` brings one)"


def _usable(place: str | Path, tokenizer: str | Path | None) -> bool:
    """Whether a CLIP and its tokenizer are here with all their files, as far as names tell."""
    from slgaussian.components.hub_cache import local_place
    from slgaussian.components.pretrained import CONFIG, find_model, find_tokenizer, read_json

    try:
        here = Path(local_place(place))
        if not here.exists():
            return False
        found = find_model(here)
        words = Path(found.folder if tokenizer is None else local_place(tokenizer))
        if not words.is_dir():
            return False
        find_tokenizer(words)
        if found.checkpoint is not None:
            return True
        return read_json(found.folder / CONFIG).get("model_type") == "clip"
    except InputError:
        return False

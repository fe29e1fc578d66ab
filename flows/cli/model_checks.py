"""What a model of CLIP, SAM or SAM 2 is, whether it is whole, and whether it knows what it must.

Each model is looked at in a program of its own (``python -m flows.cli.model_checks REQUEST``), so
that its peak memory is its own, and one that takes too much of it ends nothing else. Nothing is
downloaded.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from flows.settings import make_settings
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.parts.finding import Finding, Findings

KNOWN = {"clip": "clip", "sam": "sam", "sam2": "sam2", "sam2_video": "sam2"}
"""The part that takes a model, by its ``model_type``."""

CALLED = {"clip": "CLIP", "sam": "SAM", "sam2": "SAM 2"}
ZERO = 0.01
"""Share of the weights that may lie in matrices that are zero all over."""

KINDS = {"clip": "encoder", "sam": "proposer", "sam2": "proposer"}


@dataclass(frozen=True)
class Request:
    """A model to look at.

    Attributes
    ----------
    place : str
        File or folder.
    called : str
        What the user called it.
    part : str or None
        Which part it must fit; found out if None.
    settings : mapping
        Further ones, such as the tokenizer; those count that the part has.
    table : str or None
        Text vectors that may be its own.
    """

    place: str
    called: str
    part: str | None
    settings: Mapping[str, Any]
    table: str | None


def examine_models(places: Sequence[str], given: Mapping[str, Any]) -> Findings:
    """Look at models, one after the other.

    Parameters
    ----------
    places : sequence of str
        Files, folders or names in the hub's cache, whatever model each is.
    given : mapping
        Settings as :func:`flows.settings.make_settings` takes them. Parts that take models must be
        able to use those that they name. Of the encoder ``clip``, tokenizer and precision hold for
        ``places`` too, and the ``table`` of the encoder ``named`` is compared with every CLIP.

    Without places and parts, all that the hub's cache holds are looked at.

    Raises
    ------
    InputError
        If a setting cannot be used.
    """
    values = dict(given)
    table = values.pop("named", {}).get("table")
    own = {k: v for k, v in values.get("clip", {}).items() if k != "model"}
    if values.get("encoder") != "clip" and "model" not in values.get("clip", {}):
        values.pop("clip", None)
    checked = make_settings(values, "doctor")
    tables = checked.part_settings()
    chosen = {part: tables[part] for part in checked.part_names().values() if part in CALLED}
    requests: list[Request] = []
    for part, settings in chosen.items():
        place = settings["model"]
        if place is None:
            yield Finding(part, f"its model is not given; give --{part}-model PLACE", False)
            continue
        others = {key: value for key, value in settings.items() if key != "model"}
        requests.append(Request(str(place), str(place), part, others, table))
    requests += [Request(place, place, None, own, table) for place in places]
    if not places and not chosen:
        found = yield from _in_cache()
        requests += [Request(str(at), name, None, own, table) for name, at in found]
    for request in requests:
        yield from _looked_at_elsewhere(request)


def _in_cache() -> Generator[Finding, None, list[tuple[str, Path]]]:
    """The models in the hub's cache that can be looked at; what is left out is said."""
    from slgaussian.parts.hub_cache import cached_models

    taken: list[tuple[str, Path]] = []
    others: list[tuple[str, Path]] = []
    for name, folder in cached_models():
        try:
            kind = kind_of(folder)
        except InputError as error:
            yield Finding("hub", f"{name}: {error}", False)
            continue
        (others if kind is None else taken).append((name, folder))
    if others:
        names = ", ".join(name for name, _ in others)
        yield Finding("hub", f"in its cache, and no CLIP, SAM or SAM 2: {names}", None)
    if not taken:
        said = "its cache holds no CLIP, SAM or SAM 2; download one with `hf download NAME`, or"
        yield Finding("hub", f"{said} say where one is: slgaussian doctor --models PLACE", None)
    return taken


def kind_of(place: str | Path) -> str | None:
    """The part that takes a model by what its files say; None if there is none.

    Raises
    ------
    InputError
        If there is no model, or its configuration cannot be read.
    """
    from slgaussian.parts.pretrained import CONFIG, OPEN_CLIP_CONFIG, OPEN_CLIP_WEIGHTS, read_json

    path = Path(place)
    if path.is_file():
        return "clip"  # only checkpoints of open_clip are files
    if (path / CONFIG).is_file():
        found = KNOWN.get(str(read_json(path / CONFIG).get("model_type")))
        if found is not None:
            return found
    marks = (OPEN_CLIP_CONFIG, *OPEN_CLIP_WEIGHTS)
    return "clip" if any((path / name).exists() for name in marks) else None


def _looked_at_elsewhere(request: Request) -> Findings:
    """The findings of a program of its own, as they come."""
    from flows.runners.child import begin

    name = request.part or "model"
    with tempfile.TemporaryFile("w+") as errors:
        child = begin(
            "flows.cli.model_checks",
            json.dumps(asdict(request)),
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env={"HF_HUB_OFFLINE": "1"},
        )
        with child:
            try:
                assert child.stdout is not None
                for line in child.stdout:
                    told = Finding(**json.loads(line))
                    name = told.name
                    yield told
            except GeneratorExit:
                child.terminate()
                raise
        if child.returncode == 0:
            return
        if child.returncode < 0:
            by = signal.Signals(-child.returncode).name
            why = f"was ended by {by}; it may need more memory than there is"
        else:
            errors.seek(0)
            last = (errors.read().strip().splitlines() or ["and gave no reason"])[-1]
            why = f"failed ({one_line(last)})"
        said = f"{request.called}: cannot be checked, as the program that looked at it {why}"
        yield Finding(name, said, False)


def looked_at(request: Request) -> Findings:
    """All about one model. What is wrong with it is a finding, never an error."""
    name = request.part or "model"
    try:
        place = _here(request)
        part = request.part or kind_of(place)
        if part is None:
            known = ", ".join(CALLED.values())
            raise InputError(f"{request.called}: is no model of {known}; give the folder of one")
        name = part
        yield from _checks(request, part, place)
    except SLGaussianError as error:
        said = str(error)
        named = request.called in said or request.place in said
        yield Finding(name, said if named else f"{request.called}: {said}", False)
    except Exception as error:  # a damaged file raises almost anything
        said = one_line(f"{type(error).__name__}: {error}")
        yield Finding(name, f"{request.called}: cannot be checked ({said})", False)


def _here(request: Request) -> str:
    """Where the model is; InputError if it is nowhere on this machine."""
    from slgaussian.parts.hub_cache import local_place

    place = local_place(request.place)
    if not Path(place).exists():
        raise InputError(f"{request.called}: there is no such file or folder; correct its name")
    return place


def _checks(request: Request, part: str, place: str) -> Findings:
    from slgaussian.parts.hub_cache import local_place
    from slgaussian.parts.intact import check_numbers, check_whole, zero_matrices
    from slgaussian.parts.pretrained import find_model, model_digest
    from slgaussian.parts.registry import find_part

    found = find_model(place)
    if found.checkpoint is None:
        _check_kind(request, part, place)
    digests = {file.name: check_whole(file) for file in found.files}
    settings = {key: value for key, value in request.settings.items() if key in _takes(part)}
    if settings.get("tokenizer") is not None:
        settings["tokenizer"] = local_place(settings["tokenizer"])
    loaded = find_part(KINDS[part], part)(model=place, **settings)
    yield Finding(part, f"{request.called}: {about(loaded.network)}")
    weights = {name: digest for name, digest in digests.items() if not name.endswith(".json")}
    for name, digest in weights.items():
        yield Finding(part, f"{name}: whole, SHA-256 {digest}")
    yield Finding(part, f"known to fields as {model_digest(place)}")
    check_numbers(loaded.network, request.called)
    zero, share = zero_matrices(loaded.network)
    if zero:
        more = f" and {len(zero) - 1} more" if zero[1:] else ""
        said = f"weights: {zero[0]}{more} zero all over, {100 * share:.1f} % of all"
        reason = "; was it never trained, or did a download stop? get it again"
        bad = share > ZERO
        yield Finding(part, said + (reason if bad else ""), False if bad else None)
    if part == "clip":
        from slgaussian.language import clip_answers

        table = None if request.table is None else Path(request.table)
        yield from clip_answers.findings(loaded, table)
    else:
        from slgaussian.masks import sam_answers

        yield from sam_answers.findings(loaded)


def _check_kind(request: Request, part: str, place: str) -> None:
    """InputError if the model is one of another part: that one is named."""
    found = kind_of(place)
    if found is not None and found != part:
        raise InputError(
            f"{request.called}: is a model of {CALLED[found]}, given as {CALLED[part]}; give it as "
            f"--{found}-model, or another one here"
        )


def _takes(part: str) -> Mapping[str, Any]:
    from slgaussian.parts.registry import find_part
    from slgaussian.parts.settings import settings_of

    return settings_of(find_part(KINDS[part], part))


def about(network: Any) -> str:
    """Architecture and sizes of a loaded model, in a few words."""
    config = network.config
    count = sum(tensor.numel() for tensor in network.parameters())
    size = f"{count / 1e6:.1f} million parameters"
    vision = config.vision_config
    if config.model_type == "clip":
        text = config.text_config
        return (
            f"CLIP of {config.projection_dim} axes: images of {vision.image_size} pixels by "
            f"{vision.num_hidden_layers} layers of {vision.hidden_size}, patch "
            f"{vision.patch_size}; texts by {text.num_hidden_layers} layers of {text.hidden_size}; "
            f"{size}; its temperature is {float(network.logit_scale.exp()):.0f}"
        )
    side = config.prompt_encoder_config.image_size
    if config.model_type == "sam":
        layers = f"{vision.num_hidden_layers} layers of {vision.hidden_size}"
        return f"SAM: images of {side} pixels by {layers}, patch {vision.patch_size}; {size}"
    own = vision.backbone_config
    stages = "+".join(map(str, own.blocks_per_stage))
    return f"SAM 2: images of {side} pixels by {stages} blocks from {own.hidden_size} on; {size}"


def peak_memory() -> str:
    """The most memory that this program has held, and that of its accelerator, in words."""
    import torch

    held = _held() / 2**30
    said = f"{held:.1f} GiB of memory at the peak"
    if torch.cuda.is_available():
        said += f", and {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB of the GPU"
    return said


def _held() -> float:
    """Bytes; from /proc where there is one, as ``getrusage`` has its peak from the parent too."""
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def main(request: str) -> None:
    """Print the findings of a request, a line of JSON each."""
    name, loaded = "model", False
    for finding in looked_at(Request(**json.loads(request))):
        name, loaded = finding.name, finding.good is not False or loaded
        print(json.dumps(asdict(finding)), flush=True)
    if loaded:
        told = Finding(name, f"memory: {peak_memory()}", None)
        print(json.dumps(asdict(told)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])

"""The words of ``docs/measured/rasterizer.md``: what its tables hold, and how to read them."""

from benches.common.markdown_tables import (
    Table,
    count,
    error,
    error_under,
    fraction,
    hundredths,
    limit,
    ms,
)
from benches.rasterize import pruning_error
from benches.rasterize.parameter_sweeps import EXACT_PART

PICTURE = "Error of cut-offs and pruning; time against Gaussians, image size and channels"
EXACT_BOUND, FAST_BOUND, DENSE_BOUND = 1e-4, 1 / 255, 0.01

_DUEL = {
    "loop": ("plain loop, ms", ms),
    "fast": ("rasterize, ms", ms),
    "ratio": ("times faster", hundredths),
    "greatest": ("greatest error", error_under(FAST_BOUND)),
}
_exact, _fast = error_under(EXACT_BOUND), error_under(DENSE_BOUND)

TABLES = {
    "scenes": Table(
        "Every scene",
        "Times in ms of 6 channels: 3 colours and 3 random codes. *Back and forth* is forward and "
        "backward for means, scales, quaternions, opacities and values. A *plan* keeps the weights "
        "of one view; its *product* draws 3 channels with them. Greatest errors, in bold where not "
        "below 1/255 = 3.9e-3: of the default settings, in windows against float64 and in the "
        "whole image; of the plan, in the whole image. *Floor* is how far the picture that stands "
        "in for float64 in whole images is from it in the windows.",
        {
            "scene": ("scene", str),
            "gaussians": ("Gaussians", count),
            "loop": ("plain loop", ms),
            "fast": ("rasterize", ms),
            "ratio": ("times faster", hundredths),
            "both_ways": ("back and forth", ms),
            "both_ratio": ("/ rasterize", hundredths),
            "plan": ("plan", ms),
            "product": ("product", ms),
            "product_back": ("its backward", ms),
            "window_greatest": ("error, windows", error_under(FAST_BOUND)),
            "greatest": ("error, image", error_under(FAST_BOUND)),
            "plan_greatest": ("error, plan", error_under(FAST_BOUND)),
            "window_fine": ("floor", error),
        },
    ),
    "pruned": pruning_error.TABLES["scenes"],
    "tolerances": pruning_error.TABLES["tolerances"],
    "stages": Table(
        "Where the time goes",
        "The stages of a picture, in ms, and how many Gaussians a block of 16 pixels blends.",
        {
            "project": ("project", ms),
            "bin": ("list by tile", ms),
            "draw": ("sort and blend", ms),
            "listed": ("Gaussians a block", count),
        },
    ),
    "thresholds": Table(
        "Cut-offs",
        "A Gaussian is cut where its alpha is below `alpha_min`, and `sigmas` from its centre; a "
        "pixel is finished when less light than `pass_min` is left. Errors are what the cut-offs "
        "leave out of the picture that the same settings define. *Dense* is the greatest error on "
        "400 large Gaussians that overlap in a small image (the default's bound: 0.01). `exact` "
        "lists every Gaussian in every tile, gigabytes for a scene like this: its times are those "
        f"of a random 1/{EXACT_PART} of the scene, for the loop as well, and its errors those of "
        "windows.",
        {
            "what": ("settings", str),
            "alpha_min": ("alpha_min", fraction),
            "sigmas": ("sigmas", limit),
            "pass_min": ("pass_min", fraction),
            "seconds": ("ms", ms),
            "ratio": ("times faster", hundredths),
            "greatest": ("greatest error", error),
            "mean": ("mean error", error),
            "dense": ("dense", error),
        },
    ),
    "counts": Table(
        "Gaussians",
        "Random parts of the scene, with opacities as they are.",
        {"gaussians": ("Gaussians", count)} | _DUEL,
    ),
    "resolutions": Table(
        "Resolution",
        "The same Gaussians in an image a quarter, half, once and twice as high and wide. In bold: "
        "not below 1/255. In a small image more Gaussians share a pixel, and what is cut from each "
        "adds up.",
        {"size": ("width x height", str)} | _DUEL,
    ),
    "channels": Table(
        "Channels", "Random values in [0, 1].", {"channels": ("channels", count)} | _DUEL
    ),
    "hard_cases": Table(
        "Hard cases",
        "Scenes on which rasterisers break (`benches/rasterize/hard_cases.py`), each of them a "
        "test too. "
        "Greatest errors against the float64 reference; those of the depth are relative, where "
        "alpha is above one half. In bold: not below 1e-4 with nothing cut (`exact`), or 0.01 with "
        "the default settings (`fast`). The mean depth moves most where what is cut lies many "
        "times farther than what is drawn. Of ten thousand Gaussians that are each below the "
        "cut-off and opaque together, only `exact` draws any.",
        {
            "case": ("case", str),
            "about": ("what is hard", str),
            "exact_values": ("exact: values", _exact),
            "exact_alpha": ("alpha", _exact),
            "exact_depth": ("depth", _exact),
            "fast_values": ("fast: values", _fast),
            "fast_alpha": ("alpha", _fast),
            "fast_depth": ("depth", _fast),
        },
    ),
    "memory": Table(
        "Memory",
        "Resident memory of a fresh process, beyond libraries, kernels and inputs: at the peak, "
        "and with the result at hand. Asked: under 400 MB for a picture.",
        {"what": ("what", str), "peak": ("peak, MB", count), "kept": ("kept, MB", count)},
    ),
    "start": Table(
        "Start-up",
        "Seconds in a fresh process, with compiled kernels on disk, where the first use leaves "
        "them, and without. Reading the scene is not counted. Asked: under 1 s for the first "
        "picture with kernels on disk.",
        {
            "what": ("what", str),
            "cached": ("kernels on disk", hundredths),
            "compiling": ("none yet", hundredths),
        },
    ),
}


def page(rows: dict[str, list[dict]], scene: str, command: str, machine: str) -> str:
    """Markdown of all ``rows``, by the keys of ``TABLES``; sweeps are of ``scene``."""
    tables = "\n".join(TABLES[key].markdown(found) for key, found in rows.items())
    return f"""# The rasteriser, measured

Made by `{command}` on {machine}.

`slgaussian.rasterize` on a CPU is timed against a plain loop
(`benches/rasterize/plain_loop.py`): it projects,
sorts all Gaussians and splats one after the other, is compiled by Numba, and runs on two threads as
well. Every time is a median over rounds in which each draws once, so compare times only within a
table. Errors are absolute differences of values in [0, 1], so 1/255 = 3.9e-3 is a grey level. They
are against the float64 reference, which cuts nothing. In whole images of large scenes the reference
would take hours; there the cpu backend with `alpha_min` 2^-20 replaces it.

![{PICTURE}](rasterizer.svg)

**What limits the speed.** {limits(rows["stages"][0])}

The Gaussians are those that the plane sweep predicts from two photographs, about one a pixel, drawn
from a third camera. All tables except the first two show the scene {scene}.

{tables}"""


def limits(stages: dict) -> str:
    """Two sentences on where the time goes, from a row of ``parameter_sweeps.stages_row``."""
    whole = sum(stages[key] for key in ("project", "bin", "draw"))
    share = {key: f"{100 * stages[key] / whole:.0f} %" for key in ("project", "bin", "draw")}
    return (
        f"Sorting and blending takes {share['draw']} of the time, because {stages['listed']:.0f} "
        "Gaussians on average matter to a block of 16 pixels. Coarser cut-offs drop few of them, "
        f"so only fewer Gaussians help. Projection takes {share['project']} and listing by tile "
        f"takes {share['bin']}. Both hardly depend on the size of the image or on its channels."
    )

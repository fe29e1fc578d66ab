"""Procedural rooms: determinism, depth and instances, phrases, placement of objects."""

import itertools

import numpy as np
import pytest
from implicit_solids import implicit_value

from slgaussian.datasets.procedural import reader, rooms
from slgaussian.errors import InputError
from slgaussian.scene import View
from tests.kernel_threads import kernels_on

SMALL = {"height": 64, "width": 96}
SEEDS = range(4)


def same(a: View, b: View) -> bool:
    return all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes()
        for name in ("image", "depth", "instances")
    )


def test_bytes_depend_on_the_seed_not_on_order_and_threads():
    first, second = (reader.read(seed=3, **SMALL) for _ in range(2))
    views = {name: first.read(name) for name in first.cameras}
    with kernels_on(1):
        for name in reversed(views):
            assert same(second.read(name), views[name])
    assert first.phrases == second.phrases
    assert not same(reader.read(seed=4, **SMALL).read("view_00"), views["view_00"])


def test_depth_and_instances_lie_on_surfaces_at_pixel_centres():
    scene = reader.read(seed=5, height=208, width=288)
    view, room = scene.read("view_00"), scene.read.args[1]
    points = view.camera.unproject(view.depth)
    solids = [solid for thing in room.things for solid in thing.solids]
    values = np.stack([implicit_value(solid, points) for solid in solids])
    # Depth is float32, 2e-7 of at most 6 m.
    assert np.abs(values.min(0)).max() < 2e-6
    on_instance = (np.abs(values) < 2e-6) & (room.owners()[:, None, None] == view.instances)
    assert on_instance.any(0).all()


def test_noise_and_exposure_change_only_the_photograph():
    settings = {"seed": 1, **SMALL}
    clean = reader.read(noise=0, exposure=0, **settings).read("view_01")
    noisy = reader.read(noise=0.02, exposure=0, **settings).read("view_01")
    assert (clean.depth == noisy.depth).all() and (clean.instances == noisy.instances).all()
    middle = (clean.image > 40) & (clean.image < 215)
    spread = (noisy.image.astype(float) - clean.image)[middle].std()
    assert spread == pytest.approx(0.02 * 255, rel=0.05)
    bright = reader.read(noise=0, exposure=0.2, **settings)
    ratios = [bright.read(name).image.mean() / clean.image.mean() for name in bright.cameras]
    assert np.ptp(ratios) > 0.05


@pytest.mark.parametrize("seed", SEEDS)
def test_phrases_use_the_vocabulary_and_are_unambiguous(seed):
    phrases = list(reader.read(seed=seed, objects=10, **SMALL).phrases.values())
    assert len(set(phrases)) == len(phrases)
    looks = set()
    for phrase in phrases:
        *adjectives, noun = words = phrase.split()
        assert set(words) <= rooms.VOCABULARY
        assert noun in rooms.SHAPES or noun in rooms.STUFF
        assert not set(adjectives) - {*rooms.COLOURS, *rooms.PATTERNS, *rooms.MATERIALS}
        looks.add((rooms.find_look(phrase), noun))
    assert len(looks) == len(phrases)


@pytest.mark.parametrize("seed", SEEDS)
def test_objects_neither_intersect_nor_float(seed):
    rng = np.random.default_rng(seed)
    things = reader.read(seed=seed, objects=12, **SMALL).read.args[1].things
    for a, b in itertools.permutations(things, 2):
        for solid in a.solids:
            points = solid.centre + rng.uniform(-1, 1, (4000, 3)) * solid.reach
            within = points[implicit_value(solid, points) < 0]
            for obstacle in b.solids:
                if len(within):
                    depth = implicit_value(obstacle, within).min()
                    assert depth > -1e-9, (a.phrase, b.phrase, depth)
    for thing in things[4:]:
        if thing.phrase == "picture":
            continue
        foot = min(thing.solids, key=lambda solid: solid.centre[2])
        points = foot.centre + rng.uniform(-1, 1, (20000, 3)) * foot.reach
        lowest = points[implicit_value(foot, points) < 0][:, 2].min()
        below = np.array((foot.centre[0], foot.centre[1], lowest - 0.03))
        support = min(
            implicit_value(solid, below) for b in things if b is not thing for solid in b.solids
        )
        assert support < 0, thing.phrase


@pytest.mark.parametrize(
    ("argument", "value"),
    [("objects", 0), ("views", 1), ("height", 3), ("baseline", float("nan")), ("noise", -0.1)],
)
def test_read_error_names_argument_out_of_range(argument, value):
    with pytest.raises(InputError, match=f"procedural scene {argument}: found"):
        reader.read(**{argument: value})

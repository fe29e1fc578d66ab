"""Seeds depend on what is computed and on nothing else."""

from slgaussian.seeding import rng_for, seed_for


def test_a_seed_is_the_same_everywhere():
    assert seed_for(0, "room", "codes") == 9262441233058351170


def test_run_scene_and_stage_each_matter():
    seeds = {seed_for(*key) for key in [(0, "a", "x"), (1, "a", "x"), (0, "b", "x"), (0, "a", "y")]}
    assert len(seeds) == 4


def test_generators_repeat():
    assert rng_for(3, "a", "x").random() == rng_for(3, "a", "x").random()

"""What is asked of real weights can be answered, and is counted right."""

import numpy as np
import pytest
import torch

from slgaussian.components.known_answers import (
    PICTURES,
    SHIFT,
    coin_picture,
    find_coins,
    follow_coins,
    name_pictures,
    order_depths,
)
from slgaussian.predict import load_predictor


@pytest.mark.parametrize("right", [4, 3])
def test_pictures_are_named_by_the_text_that_fits_best(right):
    class Encoder:
        asked = 0

        def encode_text(self, texts):
            return np.eye(len(texts))

        def encode_regions(self, image, masks):
            assert masks.all() and masks.shape[1:] == image.shape[:2]
            self.asked += 1
            return np.eye(4)[[self.asked - 1 if self.asked <= right else 0]]

    assert name_pictures(Encoder()).startswith(f"names {right} of {len(PICTURES)} pictures")


@pytest.mark.parametrize("right", [24, 5])
def test_coins_are_found_at_their_middles(right):
    image, coins = coin_picture()
    assert coins.max() == 24 and image.shape == (*coins.shape, 3)

    class Proposer:
        def encode(self, seen):
            return self

        def segment(self, points):
            number = coins[tuple(points[0, ::-1].astype(int))]
            assert number > 0
            mask = torch.from_numpy((coins == number) & (number <= right))
            return torch.stack([mask * 0 - 1, mask * 2.0 - 1, mask * 0 - 1])[None], torch.ones(1, 3)

        def enlarge(self, logits):
            return logits

    assert find_coins(Proposer()).startswith(f"finds {right} of 24 coins")


@pytest.mark.parametrize("shift", [SHIFT, 20])
def test_coins_are_followed(shift):
    class Tracker:
        def add(self, seen, labels):
            self.labels = labels

        def propagate(self, seen):
            return np.roll(self.labels, shift, 1)

    assert follow_coins(Tracker()).startswith(f"follows {24 * (shift == SHIFT)} of 24 coins")


def test_depths_of_the_motorcycle_are_ordered_without_weights():
    assert order_depths(load_predictor("planesweep")).startswith(
        "orders depths of a motorcycle by 0.9"
    )

"""Write the package's table of nouns and their ImageNet classes, from WordNet 3.0.

    python -m benches.language.noun_table WORDNET SYNSETS

WORDNET is the folder with ``data.noun`` and ``index.noun`` (of the Debian package ``wordnet-base``,
version 1:3.0-37), SYNSETS a file with a WordNet 3.0 offset a line in the order of the 1,000 classes
(``timm/data/_info/imagenet_synsets.txt`` of the package timm 1.0). ImageNet takes its classes from
that version of WordNet, so that its ids are offsets there.

The classes of a sense are itself, if it is one, and its hyponyms; else its nearest hypernyms that
are classes. A noun has the classes of all senses that are classes themselves, and of its first
sense with classes, if this is among the first two visible senses. Hypernyms of the three classes of
people (groom, diver, player) have no classes, because these are not what "person" means. Words with
more than half of the classes, such as "object", are left out. :data:`USUAL` has exceptions.
"""

from __future__ import annotations

import argparse
import lzma
from collections import defaultdict
from pathlib import Path

from slgaussian.language import vocabulary

VISIBLE = {"03", "05", "06", "08", "13", "15", "17", "20", "27"}
"""Lexicographer files of animals, artifacts, body, food, locations, objects, plants, substances."""

PERSON = "18"

USUAL = {
    "ball, cone, cylinder, ring": "",
    "bag": "plastic bag, backpack, purse, mailbag",
    "bin, trash can, garbage can, dustbin, wastebasket, waste bin": "ashcan",
    "bike, bicycle": "mountain bike, bicycle-built-for-two",
    "book": "book jacket, comic book",
    "bookshelf, shelf": "bookcase",
    "boot": "cowboy boot",
    "building, house": "greenhouse, library, church, barn, boathouse, mobile home, cinema, palace",
    "cabinet, cupboard": "china closet, wardrobe, file, medicine chest, chiffonier",
    "can, tin, tin can, soda can, drink can, beer can": "pop bottle, beer bottle",
    "carpet, rug, mat": "prayer rug, doormat",
    "cd": "",
    "coffee machine": "espresso maker, coffeepot",
    "coke": "pop bottle",
    "cup, mug": "cup, coffee mug",
    "curtain": "shower curtain, theater curtain, window shade",
    "drawer": "chiffonier, desk, file",
    "ear, head, part, area, work, figure, point, home, product, portion, level, top, thing": "",
    "face mask": "mask, ski mask",
    "flower": "daisy, yellow lady's slipper, rapeseed, pot",
    "glasses": "sunglass, sunglasses",
    "heater, radiator": "radiator, space heater",
    "helmet": "crash helmet, football helmet, pickelhaube",
    "jacket": "trench coat, jean, suit, cardigan",
    "kettle": "teapot, coffeepot",
    "lamp, light": "table lamp, lampshade, spotlight",
    "lego, figure, figurine, doll": "teddy",
    "monitor, screen, display": "screen, monitor, television, desktop computer",
    "mouse": "mouse",
    "oven": "stove, microwave, rotisserie",
    "paper": "envelope, packet, toilet tissue",
    "phone, telephone, smartphone": "cellular telephone, dial telephone, pay-phone, ipod",
    "plant, potted plant, houseplant, plant pot, flower pot": "pot",
    "plate": "plate",
    "power outlet, socket, outlet": "switch",
    "printer": "printer, photocopier",
    "shoe": "running shoe, loafer, clog, sandal, cowboy boot",
    "sink, basin": "washbasin",
    "soap bottle": "lotion, soap dispenser, water bottle",
    "sofa, couch, pouf": "studio couch",
    "statue, sculpture": "",
    "table": "dining table, desk, pool table",
    "teddy bear, stuffed animal, plush": "teddy",
    "tissue": "toilet tissue, paper towel",
    "toilet": "toilet seat",
    "tv, television": "television, screen, monitor",
    "window": "window screen, window shade",
}
"""Words and the classes whose pictures show such things, by general knowledge: pictures of a
flowerpot show plants, and some words have other senses in WordNet than in a query. Shapes have no
classes, because their outline identifies them."""

FIRST_SENSES = 2
"""Number of visible senses among which the first sense with classes must be."""

MOST_CLASSES = 500
"""Largest number of classes of a word."""

MOST_WORDS = 3
"""Largest number of words of a noun."""


def read_synsets(file: Path) -> tuple[dict[int, str], dict[int, list[int]]]:
    """Return the lexicographer file and the hypernyms of every synset, by offset."""
    kinds, above = {}, {}
    for line in file.read_text("utf-8").splitlines():
        if line.startswith("  "):  # the licence
            continue
        offset, kind, _, count, *rest = line.split(" | ")[0].split()
        pointers = rest[2 * int(count, 16) + 1 :]
        kinds[int(offset)] = kind
        above[int(offset)] = [
            int(pointers[i + 1])
            for i in range(0, len(pointers) - 3, 4)
            if pointers[i] in ("@", "@i")
        ]
    return kinds, above


def classes_of_synsets(
    kinds: dict[int, str], above: dict[int, list[int]], classes: dict[int, int]
) -> tuple[dict[int, set[int]], dict[int, set[int]]]:
    """Return the classes of each synset: those it is or has as hyponyms; the nearest hypernyms."""
    below = defaultdict(set)
    for synset, number in classes.items():
        reached, left = {synset}, [synset] * (kinds[synset] != PERSON)
        while left:
            for parent in above[left.pop()]:
                if parent not in reached:
                    reached.add(parent)
                    left.append(parent)
        for ancestor in reached:
            below[ancestor].add(number)
    nearest: dict[int, set[int]] = {}
    for synset in above:
        level = [synset]
        while level and synset not in nearest:
            numbers = {classes[parent] for parent in level if parent in classes}
            if numbers:
                nearest[synset] = numbers
            level = [parent for child in level for parent in above[child]]
    return below, nearest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wordnet", type=Path)
    parser.add_argument("synsets", type=Path)
    arguments = parser.parse_args()
    offsets = [int(line[1:]) for line in arguments.synsets.read_text().split()]
    classes = {offset: number for number, offset in enumerate(offsets)}
    kinds, above = read_synsets(arguments.wordnet / "data.noun")
    below, nearest = classes_of_synsets(kinds, above, classes)
    numbers_of: dict[str, set[int]] = {}
    called: dict[str, set[int]] = {}
    for line in (arguments.wordnet / "index.noun").read_text("utf-8").splitlines():
        if line.startswith("  "):
            continue
        lemma, _, count, *rest = line.split()
        senses = [int(offset) for offset in rest[-int(count) :]]
        visible = [s for s in senses if s in classes or kinds[s] in VISIBLE]
        first = next((s for s in visible[:FIRST_SENSES] if below.get(s) or s in nearest), None)
        numbers = set()
        for sense in visible:
            if sense in classes or sense == first:
                numbers |= below.get(sense) or nearest.get(sense, set())
        word = lemma.replace("_", " ")
        if any(s in classes for s in senses):
            called.setdefault(word, {classes[s] for s in senses if s in classes})
        plain = word.replace(" ", "").replace("-", "").replace("'", "").isalpha()
        if numbers and len(numbers) <= MOST_CLASSES and plain and len(word.split()) <= MOST_WORDS:
            numbers_of[word] = numbers
    for spelled, names in USUAL.items():
        usual = set().union(*(called[name] for name in names.split(", ") if name))
        numbers_of |= dict.fromkeys(spelled.split(", "), usual)
    words: dict[tuple[int, ...], list[str]] = defaultdict(list)
    for word, numbers in numbers_of.items():
        if numbers:
            words[tuple(sorted(numbers))].append(word)
    lines = [
        " ".join(map(str, numbers)) + "\t" + ",".join(spelled)
        for numbers, spelled in sorted(words.items())
    ]
    text = "\n".join(lines) + "\n"
    target = Path(vocabulary.__file__).with_name(vocabulary.TABLE)
    target.write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))
    print(f"{target}: {sum(map(len, words.values()))} words, {target.stat().st_size} bytes")


if __name__ == "__main__":
    main()

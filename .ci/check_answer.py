"""Is the answer to a question about the demo, as ``query --json`` prints it, one?"""

import json
import sys

from PIL import Image

for line in sys.stdin:
    answer = json.loads(line)
    with Image.open(answer["picture"]) as picture:
        picture.load()
    assert picture.format == "PNG" and min(picture.size) > 100, picture
    assert answer["found"] and answer["verdict"] == "found", answer
    assert answer["pixels"] > 0 and answer["objects"] and answer["score"] > 0.5, answer
    x, y = answer["point"]
    print(f"== {answer['text']}: score {answer['score']:.3f} at x {x}, y {y}; {picture}")

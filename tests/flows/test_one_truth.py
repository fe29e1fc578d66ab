"""One answer in all outputs: sentence, JSON, exit status, picture (page: ``test_page.py``)."""

import numpy as np
import pytest
from PIL import Image

from slgaussian.benchmark import pictures
from tests.viewer import test_page

CASES = [
    ("floor", "found", 0),
    ("cabinet", "not sure", 3),
    ("turquoise", "not here", 3),  # none fits
    ("quixotic floor", "found", 0),
    ("qwxyz", "cannot tell", 3),
    ("the floor of plants", "found", 0),
]


field = test_page.field
"""A made-up room of which all is known."""


@pytest.fixture(scope="module")
def folder(field, tmp_path_factory):
    place = tmp_path_factory.mktemp("truth") / "field"
    field.save(place)
    return place


@pytest.mark.parametrize(("text", "verdict", "status"), CASES)
def test_sentence_json_status_and_picture_agree(
    field, folder, tmp_path, slg, ask, text, verdict, status
):
    view = field.render(next(iter(field.cameras.values())))
    hit = view.query(text)
    assert (hit.verdict, hit.found) == (verdict, verdict == "found")
    code, printed, _ = slg("query", folder, text, "-o", tmp_path / "a.png")
    assert code == status and printed.splitlines()[0] == hit.summary
    assert hit.summary.removeprefix("probably ").startswith(verdict)
    code, (answer,) = ask("query", folder, text)
    assert code == status and answer["found"] is (code == 0)
    assert (answer["verdict"], answer["summary"]) == (verdict, hit.summary)
    assert (answer["point"] is None) == (answer["pixels"] == 0) == (not hit.shown)
    assert ("for 'floor' alone" in hit.summary) == (hit.unknown == ("quixotic",))
    # The last panel: what is drawn, and its caption.
    bold = pictures.draw_outline(view.rgb, hit.mask, pictures.PREDICTED_COLOUR)
    places = {
        "found": pictures.draw_point(bold, hit.point),
        "not sure": pictures.draw_dashed_outline(view.rgb, hit.mask, pictures.PREDICTED_COLOUR),
    }.get(verdict, view.rgb)
    panels = [("", view.rgb), ("", view.rgb), (hit.summary, places)]
    width = view.rgb.shape[1] + 12
    drawn, expected = np.asarray(Image.open(tmp_path / "a.png")), pictures.side_by_side(panels)
    np.testing.assert_array_equal(drawn[:, -width:], expected[:, -width:])
    assert ask("segment", folder, text, "wall")[1][0]["verdict"] == verdict


@pytest.mark.parametrize(
    ("texts", "status"),
    [
        (["floor", "purple ball"], 0),
        (["floor", "cabinet"], 3),
        (["floor", "zorp"], 3),
        (["floor", "not red"], 1),
    ],
)
def test_query_status_is_zero_only_with_all_texts_in_a_view(folder, ask, texts, status):
    assert ask("query", folder, *texts)[0] == status
    assert ask("query", folder, *texts, "--view", "0", "--view", "1")[0] == status

"""Which scenes and answers a report shows."""

from slgaussian.benchmark.reports.look import choose_scenes, few_a_scene, ranked


def row_of(scene, query, iou, hit=True, **more):
    row = {"scene": scene, "frame": "f", "query": query, "iou": iou, "protocol": "p@1"}
    return {**row, "dataset": "d", "hit_mask": hit, "hit_box": hit, **more}


def test_the_worst_are_those_of_least_iou_and_then_those_that_point_elsewhere():
    rows = [
        row_of("a", "good", 0.9),
        row_of("a", "near", 0.0),
        row_of("a", "lost", 0.0, hit=False),
        row_of("a", "no truth", None),
    ]
    assert [row["query"] for row in ranked(rows)] == ["lost", "near", "good"]


def test_no_scene_takes_all_places_unless_there_is_no_other():
    rows = [row_of("a", str(k), 0.0) for k in range(6)]
    rows += [row_of(scene, "q", 0.5) for scene in "bcdef"]
    chosen = few_a_scene(rows, 5)
    assert [row["scene"] for row in chosen] == ["a", "a", "b", "c", "d"]
    assert len(few_a_scene(rows[:6], 5)) == 5
    assert few_a_scene([], 5) == []


def test_every_data_set_has_its_share_and_a_query_is_shown_once_a_scene():
    rows = [row_of(scene, "q", 0.0) for scene in "abcd"]
    rows += [row_of(scene, "q", 0.1, dataset="e") for scene in "xy"]
    assert [row["scene"] for row in few_a_scene(rows, 4)] == ["a", "b", "x", "y"]
    # The places that one data set does not need, the other fills.
    assert [row["scene"] for row in few_a_scene(rows[:5], 4)] == ["a", "b", "c", "x"]
    again = [row_of("a", "q", 0.0, frame="g"), *rows]
    assert [row["frame"] for row in few_a_scene(again, 5)[:2]] == ["g", "f"]
    assert sum(row["scene"] == "a" for row in few_a_scene(again, 5)) == 1


def test_the_scene_that_opens_the_page_is_the_middle_one():
    chosen = choose_scenes(
        [(f"s{k}", "a", {"iou": iou}) for k, iou in enumerate((0.9, 0.1, 0.5))]
        + [("t0", "b", {}), ("t1", "b", {}), ("u", "c", {"iou": 1.0})]
    )
    assert chosen == {
        "s2": "in the middle by IoU of the 3 scenes of a",
        "t0": "the first of the 2 scenes of b",
        "u": "",
    }

import numpy as np

from slgaussian.benchmark import pictures, showcase


def row_of(scene, query, iou, hit=True, **more):
    row = {"scene": scene, "frame": "f", "query": query, "iou": iou, "protocol": "p@1"}
    return {**row, "dataset": "d", "hit_mask": hit, "hit_box": hit, **more}


def test_the_worst_are_those_of_least_iou_and_then_those_that_point_elsewhere():
    rows = [
        row_of("a", "good", 0.9),
        row_of("a", "near", 0.0),
        row_of("a", "lost", 0.0, hit=False),
        row_of("a", "untold", None),
    ]
    assert [row["query"] for row in showcase.ranked(rows)] == ["lost", "near", "good"]


def test_no_scene_takes_all_places_unless_there_is_no_other():
    rows = [row_of("a", str(k), 0.0) for k in range(6)]
    rows += [row_of(scene, "q", 0.5) for scene in "bcdef"]
    chosen = showcase.few_a_scene(rows, 5)
    assert [row["scene"] for row in chosen] == ["a", "a", "b", "c", "d"]
    assert len(showcase.few_a_scene(rows[:6], 5)) == 5
    assert showcase.few_a_scene([], 5) == []


def test_every_data_set_has_its_share_and_a_query_is_shown_once_a_scene():
    rows = [row_of(scene, "q", 0.0) for scene in "abcd"]
    rows += [row_of(scene, "q", 0.1, dataset="e") for scene in "xy"]
    assert [row["scene"] for row in showcase.few_a_scene(rows, 4)] == ["a", "b", "x", "y"]
    # What one data set has not, the other has.
    assert [row["scene"] for row in showcase.few_a_scene(rows[:5], 4)] == ["a", "b", "c", "x"]
    again = [row_of("a", "q", 0.0, frame="g"), *rows]
    assert [row["frame"] for row in showcase.few_a_scene(again, 5)[:2]] == ["g", "f"]
    assert sum(row["scene"] == "a" for row in showcase.few_a_scene(again, 5)) == 1


def test_queries_that_tell_methods_apart():
    own = [row_of("s", q, iou) for q, iou in (("lost", 0.1), ("won", 0.9), ("same", 0.5))]
    other = [row_of("s", q, iou) for q, iou in (("lost", 0.8), ("won", 0.2), ("same", 0.5))]
    told = showcase.telling(own, {"other": other}, 5)
    assert told == [("s", "f", "lost"), ("s", "f", "won")]
    assert showcase.telling(own, {}, 5) == []
    assert showcase.telling(own, {"other": other}, 1) == [("s", "f", "lost")]


def test_outlines_are_drawn_where_the_masks_end():
    photo = np.full((40, 60, 3), 120, np.uint8)
    truth, found = np.zeros((2, 40, 60), bool)
    truth[10:20, 10:20] = True
    found[5:35, 30:50] = True
    told = showcase.outlined(photo, truth)
    assert told[10, 15].tolist() == list(pictures.TRUE)
    assert np.array_equal(told[30], photo[30])
    answer = showcase.answered(photo, truth, found)
    assert answer[5, 40].tolist() == list(pictures.PREDICTED)
    assert answer[10, 15].tolist() == list(pictures.TRUE)
    assert np.array_equal(answer[20, 40], photo[20, 40])
    assert answer[38, 2].max() < 60

"""Learning curves, models and pictures of demonstrations become pictures that tell what they show."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from resync_robot.curriculum.plots import contact_sheet, draw_distillation, draw_learning_curve, draw_model
from resync_robot.planning.model_graph import graph_of
from resync_robot.sim_training.domains.cornered_insertion_s.domain import INSERT, PICK


def test_the_curve_is_drawn_where_success_went(tmp_path: Path) -> None:
    def blue_rows(success: list[float]) -> list[int]:
        path = tmp_path / "curve.png"
        draw_learning_curve({"steps": [0, 1e5], "success": success, "seconds": [0, 60]}, path)
        picture = cv2.imread(str(path))
        assert picture.shape[0] > 300 and picture.shape[1] > 600
        blue = (picture[..., 0] > 150) & (picture[..., 2] < 80)
        return sorted({int(row) for row in blue.nonzero()[0]})

    # Pixel rows count from the top.
    assert blue_rows([0.9, 0.9])[-1] < blue_rows([0.1, 0.1])[0]
    assert len(blue_rows([0.1, 0.9])) > 100


def test_what_was_counted_before_any_episode_ran_out_of_time_is_set_apart(tmp_path: Path) -> None:
    """The rate begins too high, and falls though no skill is lost."""

    def blue_rows(first_time_limit: float) -> np.ndarray:
        path = tmp_path / "curve.png"
        curve = {"steps": [2e3, 4e3, 6e3, 1e5], "success": [0.9, 0.9, 0.1, 0.1], "seconds": [0, 1, 2, 60]}
        draw_learning_curve(curve, path, first_time_limit)
        picture = cv2.imread(str(path)).astype(int)
        return np.flatnonzero(((picture[..., 0] > 150) & (picture[..., 2] < 80)).any(axis=1))

    whole, counted = blue_rows(0.0), blue_rows(5e3)
    assert whole.min() < 150 and counted.min() > 250


def test_a_distillation_shows_every_trial(tmp_path: Path) -> None:
    path = tmp_path / "distil.png"
    points = [{"step": 100 * i, "success": 80 + i, "worlds": 96} for i in (1, 2, 3)]
    draw_distillation([(25.0 * i, 1.0 / i) for i in range(1, 13)], points, 300, path)
    picture = cv2.imread(str(path)).astype(int)
    blue = ((picture[..., 0] > 150) & (picture[..., 2] < 80)).astype(np.uint8)
    assert cv2.connectedComponents(blue)[0] - 1 == 3


def test_a_contact_sheet_has_every_picture_and_names_beside_them() -> None:
    shown = np.zeros((2, 3, 2, 64, 64, 3), np.uint8)
    for r, c, v in np.ndindex(2, 3, 2):
        shown[r, c, v] = 60 + 100 * r + 30 * c + 5 * v, 7, 9
    sheet = contact_sheet(shown, ("front", "wrist"))
    for r, c, v in np.ndindex(2, 3, 2):
        assert (sheet == shown[r, c, v, 0, 0]).all(-1).sum() == 64 * 64
    above, left = sheet[:40], sheet[40:, :56]
    assert (above < 100).any() and (left < 120).any(), "words"
    assert contact_sheet(shown[:0], ("front", "wrist")).shape[0] == 40


def test_of_a_model_what_was_learned_is_orange_and_what_comes_first_stands_above(tmp_path: Path) -> None:
    def rows(learned: set[str]) -> tuple[list[int], list[int]]:
        """Where the boxes of given skills are, and of learned ones, from above to below."""
        draw_model(graph_of((PICK, INSERT), learned), tmp_path / "model.png")
        picture = cv2.imread(str(tmp_path / "model.png")).astype(int)
        blue = (picture[..., 0] > 150) & (picture[..., 2] < 80)
        orange = (picture[..., 2] > 180) & (picture[..., 0] < 80)
        # Boxes are wide, arrows are not.
        return tuple(np.flatnonzero(np.diff((found.sum(1) > 20).astype(int)) == 1).tolist() for found in (blue, orange))

    given, learned = rows(set())
    assert len(given) == 2 and not learned
    assert rows({"Insert"}) == (given[:1], given[1:])
    assert rows({"Pick"}) == (given[1:], given[:1])
    assert rows({"Holding"})[0] == given

"""The learning curve becomes a picture."""

from __future__ import annotations

from pathlib import Path

import cv2

from resync_robot.plots import draw_learning_curve


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
